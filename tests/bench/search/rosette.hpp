#pragma once
// Where lidars without rings look: two optical parts that turn at rates without a common measure,
// so that no sweep repeats the one before. Views and points a second are those of the makers' data
// sheets (Livox Mid-360, HAP); the exact curves are not published, and these are like them in what
// matters here: strokes that cross each other at a slant, several lasers side by side.

#include <Eigen/Core>
#include <cstddef>
#include <string>

namespace zloam::search {

struct Rosette {
  std::size_t lasers = 1;  ///< fire in turn
  double points_per_s = 0.0;
  double view_deg = 360.0;  ///< horizontal, whole, about straight ahead
  double low_deg = 0.0;
  double high_deg = 0.0;
  double first_hz = 0.0;
  double second_hz = 0.0;

  /// A unit vector, frame lidar.
  Eigen::Vector3d direction(double time_s, std::size_t laser) const;
};

/// "mid360" or "hap"; throws std::invalid_argument for another name.
Rosette rosette_named(const std::string& name);

}  // namespace zloam::search
