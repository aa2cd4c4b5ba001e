#pragma once
// Scan patterns of lidars without rings: two optical parts rotate at incommensurable rates, so that
// no sweep repeats the one before. Field of view and points per second are from the data sheets
// (Livox Mid-360, HAP). The exact curves are not published; these have the properties that matter
// here: strokes that cross at an angle, and several lasers side by side.

#include <Eigen/Core>
#include <cstddef>
#include <string>

namespace zloam::search {

struct Rosette {
  std::size_t lasers = 1;  ///< number of lasers, which fire in turn
  double points_per_s = 0.0;
  double view_deg = 360.0;  ///< full horizontal angle, centred straight ahead
  double low_deg = 0.0;
  double high_deg = 0.0;
  double first_hz = 0.0;
  double second_hz = 0.0;

  /// Direction of a shot: unit vector, frame lidar.
  Eigen::Vector3d direction(double time_s, std::size_t laser) const;
};

/// "mid360" or "hap"; throws std::invalid_argument for another name.
Rosette rosette_named(const std::string& name);

}  // namespace zloam::search
