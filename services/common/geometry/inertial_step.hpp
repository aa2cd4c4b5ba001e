#pragma once
// What an inertial sensor says of the motion from one sweep to the next, its biases and gravity
// taken out.

#include "common/geometry/se3.hpp"

namespace zloam {

/// Two adjoining sweeps, `before` and `now`, each with its mean velocity: the way from its begin to
/// its end over its period.
struct InertialStep {
  /// of `now` less that of `before`, frame base_link at the end of `before`, m/s
  Eigen::Vector3d velocity_change_mps = Eigen::Vector3d::Zero();
  /// rotation vector of `now` from its begin to its end, rad
  Eigen::Vector3d turn_rad = Eigen::Vector3d::Zero();
  /// of both, in this order: (m/s)^2, rad^2
  Matrix6 covariance = Matrix6::Identity();
  /// the platform has not moved since the run began
  bool at_rest = false;
};

/// What a platform at rest may move by all the same, one sigma.
inline constexpr double kRestSpeed_mps = 0.01;
inline constexpr double kRestRate_radps = 0.002;

/// The twist of `now` over its period (m, rad), given that of `before` over its own.
Vector6 twist_after(const InertialStep& step, const Vector6& twist_before, double period_before_s,
                    double period_now_s);

/// What that twist changes by with the twist before: translation by translation and by rotation.
Matrix6 twist_after_jacobian(const InertialStep& step, const Vector6& twist_before,
                             double period_before_s, double period_now_s);

}  // namespace zloam
