#include "integration/own_motion.hpp"

#include <cmath>
#include <utility>

#include "integration/contradiction.hpp"

namespace zloam::integration {

void OwnMotion::forget_motion() {
  last_.reset();
  velocity_mps_.reset();
}

void OwnMotion::begun_before() {
  forget_motion();
  begins_ = false;
}

Eigen::Vector3d OwnMotion::unexplained_m(std::int64_t instant_ns, const Pose& T_map_base,
                                         const Matrix6& covariance) {
  const Last now{instant_ns, T_map_base, covariance.topLeftCorner<3, 3>()};
  const std::optional<Last> before = std::exchange(last_, now);
  if (!before) return Eigen::Vector3d::Zero();
  const double over_s = 1e-9 * static_cast<double>(instant_ns - before->instant_ns);
  if (!(over_s > 0.0)) {
    forget_motion();
    return Eigen::Vector3d::Zero();
  }
  const Pose step = before->T_map_base.inverse() * T_map_base;
  const Eigen::Matrix3d R_now_before = step.linear().transpose();
  const Eigen::Vector3d velocity_mps = R_now_before * step.translation() / over_s;
  std::optional<Eigen::Vector3d> expected_mps = std::exchange(velocity_mps_, velocity_mps);
  const bool begins = std::exchange(begins_, false);
  if (begins) expected_mps.emplace(Eigen::Vector3d::Zero());
  if (!expected_mps) return Eigen::Vector3d::Zero();
  const Eigen::Vector3d change_mps = velocity_mps - R_now_before * *expected_mps;
  const Eigen::Matrix3d explained_m2 =
      now.covariance_m2 + R_now_before * before->covariance_m2 * R_now_before.transpose() +
      std::pow(over_s, 4) * accelerations_.translation();
  learn(change_mps, over_s, begins);
  return contradiction(change_mps * over_s, explained_m2);
}

void OwnMotion::learn(const Eigen::Vector3d& change_mps, double over_s, bool begins) {
  // Written so that NaN is a discontinuity. The next step, at the velocity before it, is none.
  if (!(change_mps.norm() * over_s < kBreak_m)) return velocity_mps_.reset();
  // A sensor that is in motion when it starts has not accelerated.
  if (begins) return;
  Vector6 acceleration = Vector6::Zero();
  acceleration.head<3>() = change_mps / over_s;
  accelerations_.add(acceleration);
}

}  // namespace zloam::integration
