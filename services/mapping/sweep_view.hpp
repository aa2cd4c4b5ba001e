#pragma once
// Range that a sweep sees in each direction, to find walls that it sees through.

#include <Eigen/Core>
#include <vector>

#include "mapping/mapping.hpp"

namespace zloam::mapping {

class SweepView {
 public:
  explicit SweepView(const MappingInput& input);

  /// Range of the nearest return in a direction (unit, frame lidar) or next to it, m; 0: there is
  /// none.
  float nearest_m(const Eigen::Vector3f& direction) const;

 private:
  // 2 degrees each; elevations start straight down.
  static constexpr int kAzimuths = 180, kElevations = 90;
  struct Bin {
    int azimuth, elevation;
  };
  static Bin bin_of(const Eigen::Vector3f& direction);
  static std::size_t index(int azimuth, int elevation) {
    return static_cast<std::size_t>(elevation) * kAzimuths + static_cast<std::size_t>(azimuth);
  }
  std::vector<float> nearest_m_;
};

}  // namespace zloam::mapping
