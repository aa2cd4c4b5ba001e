#pragma once
// How far a robot has driven. No Zenoh, no message, no clock: tested with numbers alone.

#include <Eigen/Core>
#include <optional>

namespace zloam::odometer {

struct DistanceConfig {
  /// A robot that stands has poses that differ by their noise: less is not driven.
  double min_step_m = 0.05;
};

class Distance {
 public:
  /// Of base_link in the map, in the order of time; returns the length of the way so far, in m.
  double add(const Eigen::Vector3d& position_m, const DistanceConfig& config) {
    const double step_m = last_m_ ? (position_m - *last_m_).norm() : 0.0;
    if (!last_m_ || step_m >= config.min_step_m) {
      driven_m_ += step_m;
      last_m_ = position_m;
    }
    return driven_m_;
  }

 private:
  std::optional<Eigen::Vector3d> last_m_;
  double driven_m_ = 0.0;
};

}  // namespace zloam::odometer
