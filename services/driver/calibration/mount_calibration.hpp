#pragma once
// Where a scanner sits on its motor, and by how much the motor's stamps are late, from a recording
// of a platform that stands still: the flat things that it saw are flat when both are right.
//
// Minimised with Ceres: distances of the points in a voxel from the plane through all of them, the
// plane being a function of the unknowns (variable projection). Voxels are chosen again with each
// solution, larger and thicker ones first. A turn of the scanner about the motor's axis is the
// encoder's zero, and a shift along the axis moves every point alike: neither can be found.

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
  /// whether the recording tells it: sigma is below what is asked for
  bool found = false;
};

struct MountCalibration {
  Unknown pitch_deg, yaw_deg;  ///< of the scanner in what the motor turns
  Unknown y_m, z_m;            ///< its place there
  Unknown delay_ms;            ///< of the angles' stamps against the lines'
  /// of the points about their planes, one sigma, before and after
  double before_m = 0.0;
  double after_m = 0.0;
  std::size_t points = 0;
  /// of all returns: how many lie on planes
  double flat_share = 0.0;
  std::size_t planes = 0;
  /// empty: all is found; else what stands against it
  std::string objection;

  std::array<const Unknown*, 5> unknowns() const {
    return {&pitch_deg, &yaw_deg, &y_m, &z_m, &delay_ms};
  }
};

/// start: what is known before; its axis, zero and direction stand. Throws std::invalid_argument
/// for a recording without lines or angles.
MountCalibration calibrate(const Recording& recording, const spinning::Mount& start);

}  // namespace zloam::driver::calibration
