#pragma once
// Calibrates where a scanner sits on its motor, and the delay of the motor's stamps, from a
// recording of a standing platform: its flat surfaces are flat in the points when both are right.
//
// Minimised with Ceres: distances of the points in a voxel from the plane through all of them, the
// plane being a function of the unknowns (variable projection). Voxels are chosen again with each
// solution, larger and thicker ones first. A rotation of the scanner about the motor's axis equals
// the encoder's zero, and a shift along the axis moves every point alike: neither is observable.

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "driver/scip/client.hpp"
#include "driver/spinning/angle_track.hpp"
#include "driver/spinning/sweeps.hpp"

namespace zloam::driver::calibration {

struct Recording {
  scip::Parameters scanner;
  std::vector<scip::TimedScan> lines;
  spinning::AngleTrack angles;
};

struct Unknown {
  double value = 0.0;
  double sigma = 0.0;
  /// the recording determines it: sigma is below the required limit
  bool found = false;
};

struct MountCalibration {
  /// corrections of the initial mount across the motor's axis, in a frame whose x lies along it
  Unknown pitch_deg, yaw_deg, y_m, z_m;
  Unknown delay_ms;  ///< of the angles' stamps against the lines'
  /// of the points about their planes, one sigma, before and after the calibration
  double before_m = 0.0;
  double after_m = 0.0;
  std::size_t points = 0;
  /// share of all returns that lie on planes
  double flat_share = 0.0;
  std::size_t planes = 0;
  /// the initial mount with what was found
  spinning::Mount mount;
  /// empty: all unknowns are found; else why not
  std::string objection;

  std::array<const Unknown*, 5> unknowns() const {
    return {&pitch_deg, &yaw_deg, &y_m, &z_m, &delay_ms};
  }
};

/// start: initial values; its axis, zero and direction are kept, which no recording determines:
/// with the opposite direction, a mirrored world is just as flat. Throws std::invalid_argument for
/// a recording without lines or angles.
MountCalibration calibrate(const Recording& recording, const spinning::Mount& start);

}  // namespace zloam::driver::calibration
