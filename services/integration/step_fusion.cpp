#include "integration/step_fusion.hpp"

#include <Eigen/LU>
#include <algorithm>

#include "integration/contradiction.hpp"

namespace zloam::integration {
namespace {

// A motion that was measured over a longer time, or is older, predicts nothing.
constexpr double kFreshMotion_s = 0.5;
// The same as kBreak_m, of a rotation.
constexpr double kBreak_rad = 0.5;
// Minimum number of mapped poses to weight the two predictions: before, the odometry leads unless
// it reports a degenerate direction.
constexpr int kFewest = 5;
// Lower limit of both errors: smaller ones cannot be told from errors of the mapped poses.
constexpr double kFloor_m = 0.001;
constexpr double kFloor_rad = 0.0002;

bool is_break(const Vector6& error) {
  // Written so that NaN is a break.
  return !(error.head<3>().norm() < kBreak_m && error.tail<3>().norm() < kBreak_rad);
}

// Part of the difference from the odometry's step to the map's, weighted by their mean squared
// errors.
Eigen::Vector3d weighed(const Eigen::Vector3d& ahead, const Eigen::Matrix3d& odometry,
                        const Eigen::Matrix3d& map, double floor) {
  const Eigen::Matrix3d least = floor * floor * Eigen::Matrix3d::Identity();
  return (odometry + least) * (odometry + map + 2.0 * least).inverse() * ahead;
}

}  // namespace

void StepFusion::observe(const Pose& mapped_step, const Matrix6& mapped_covariance,
                         const Pose& odometry_step, double over_s, int sweeps) {
  if (!(over_s > 0.0) || over_s > kFreshMotion_s || sweeps < 1) {
    forget_motion();
    return;
  }
  const Vector6 odometry_error = log_se3(odometry_step.inverse() * mapped_step) / sweeps;
  if (is_break(odometry_error)) {
    forget_motion();
    return;
  }
  const Pose fused_step = step(odometry_step, {}, over_s, over_s);
  fused_.add(unexplained(log_se3(fused_step.inverse() * mapped_step), mapped_covariance) / sweeps);
  odometry_.add(odometry_error);
  if (twist_per_s_) {
    const Vector6 error = log_se3(exp_se3(-*twist_per_s_ * over_s) * mapped_step) / sweeps;
    if (!is_break(error)) map_.add(error);
  }
  twist_per_s_ = log_se3(mapped_step) / over_s;
}

Eigen::Vector3d StepFusion::contradiction_m(const Pose& mapped_step,
                                            const Matrix6& mapped_covariance,
                                            const Pose& odometry_step, int sweeps) const {
  const Eigen::Vector3d error_m = log_se3(odometry_step.inverse() * mapped_step).head<3>();
  const Eigen::Matrix3d expected = mapped_covariance.topLeftCorner<3, 3>() +
                                   double(sweeps) * double(sweeps) * odometry_.translation();
  return contradiction(error_m, expected);
}

Pose StepFusion::step(const Pose& odometry_step, const Weak& weak, double over_s,
                      double age_s) const {
  if (!twist_per_s_ || age_s > kFreshMotion_s) return odometry_step;
  if (odometry_.errors() < kFewest && !weak.degenerate) return odometry_step;
  const Vector6 ahead = log_se3(odometry_step.inverse() * exp_se3(*twist_per_s_ * over_s));
  if (is_break(ahead)) return odometry_step;
  Eigen::Matrix3d unseen = Eigen::Matrix3d::Zero();
  if (weak.degenerate && weak.translation.allFinite()) {
    const double sigma_m = std::clamp(weak.sigma_measured, 0.0, kBreak_m);
    unseen = sigma_m * sigma_m * weak.translation * weak.translation.transpose();
  }
  Vector6 change;
  change << weighed(ahead.head<3>(), odometry_.translation() + unseen, map_.translation(),
                    kFloor_m),
      weighed(ahead.tail<3>(), odometry_.rotation(), map_.rotation(), kFloor_rad);
  return change.allFinite() ? odometry_step * exp_se3(change) : odometry_step;
}

std::optional<Matrix6> StepFusion::covariance(double age_s) const {
  if (fused_.errors() == 0) return std::nullopt;
  return age_s > kFreshMotion_s ? odometry_.covariance() : fused_.covariance();
}

}  // namespace zloam::integration
