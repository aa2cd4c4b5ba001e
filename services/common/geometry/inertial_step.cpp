#include "common/geometry/inertial_step.hpp"

namespace zloam {
namespace {

// Jacobian of the displacement under a constant body twist with rotation theta by the twist's
// translation: the left Jacobian of SO(3).
Eigen::Matrix3d way_by_translation(const Eigen::Vector3d& theta) {
  Eigen::Matrix3d v;
  for (int i = 0; i < 3; ++i) {
    Vector6 unit;
    unit << Eigen::Vector3d::Unit(i), theta;
    v.col(i) = exp_se3(unit).translation();
  }
  return v;
}

}  // namespace

Vector6 twist_after(const InertialStep& step, const Vector6& twist_before, double period_before_s,
                    double period_now_s) {
  // The mean velocity of the sweep before, seen from its end.
  const Eigen::Vector3d before = -exp_se3(-twist_before).translation() / period_before_s;
  Pose motion = Pose::Identity();
  motion.linear() = exp_so3(step.turn_rad);
  motion.translation() = period_now_s * (before + step.velocity_change_mps);
  return log_se3(motion);
}

Matrix6 twist_after_jacobian(const InertialStep& step, const Vector6& twist_before,
                             double period_before_s, double period_now_s) {
  const Eigen::Matrix3d to_twist =
      (period_now_s / period_before_s) * way_by_translation(step.turn_rad).inverse();
  Matrix6 jacobian = Matrix6::Zero();
  jacobian.topLeftCorner<3, 3>() = to_twist * way_by_translation(-twist_before.tail<3>());
  // To first order, the displacement is rotated by half of the sweep's rotation.
  jacobian.topRightCorner<3, 3>() = 0.5 * to_twist * hat(twist_before.head<3>());
  return jacobian;
}

}  // namespace zloam
