#pragma once
// The IMU's preintegrated motion from one sweep to the next, with biases and gravity
// removed.

#include "common/geometry/se3.hpp"

namespace zloam {

/// Two consecutive sweeps, `before` and `now`, each with its mean velocity: its displacement from
/// begin to end over its period.
struct InertialStep {
  /// of `now` minus that of `before`, frame base_link at the end of `before`, m/s
  Eigen::Vector3d velocity_change_mps = Eigen::Vector3d::Zero();
  /// rotation vector of `now` from its begin to its end, rad
  Eigen::Vector3d turn_rad = Eigen::Vector3d::Zero();
  /// of both, in this order: (m/s)^2, rad^2
  Matrix6 covariance = Matrix6::Identity();
  /// the platform has not moved since the run began
  bool at_rest = false;
};

/// Motion that a platform at rest may still have, one sigma.
inline constexpr double kRestSpeed_mps = 0.01;
inline constexpr double kRestRate_radps = 0.002;

/// The twist of `now` over its period (m, rad), given that of `before` over its own.
Vector6 twist_after(const InertialStep& step, const Vector6& twist_before, double period_before_s,
                    double period_now_s);

/// Jacobian of that twist by the twist before: translation by translation and by rotation.
Matrix6 twist_after_jacobian(const InertialStep& step, const Vector6& twist_before,
                             double period_before_s, double period_now_s);

}  // namespace zloam
