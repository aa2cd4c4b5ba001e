#pragma once
// Covariance of the odometry's motion since the sweep mapped before.

#include <cstdint>
#include <optional>

#include "common/geometry/se3.hpp"
#include "mapping/odometry_watch.hpp"

namespace zloam::mapping {

/// Adds up the steps of the poses that arrive, mapped or not. Each has its own covariance; that of
/// poses which mapping was too slow to take is not known and counts as that of the next one.
class StepCovariance {
 public:
  /// covariance: of the motion since prev_sweep, tangent at base_link.
  void add(std::uint64_t sweep, std::uint64_t prev_sweep, const Pose& T_odom_base,
           const Matrix6& covariance) {
    if (before_) {
      since_ = carried(since_, T_odom_base.inverse() * before_->T_odom_base);
      since_ += steps_since(before_->sweep, sweep, prev_sweep) * covariance;
    } else {
      since_ += covariance;
    }
    before_ = Seen{sweep, T_odom_base};
  }
  /// Since the last call.
  Matrix6 take() {
    const Matrix6 since = since_;
    since_.setZero();
    return since;
  }

 private:
  struct Seen {
    std::uint64_t sweep;
    Pose T_odom_base;
  };
  std::optional<Seen> before_;
  Matrix6 since_ = Matrix6::Zero();
};

}  // namespace zloam::mapping
