// Covariance, degenerate direction and health of a fused pose.

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/geometry/motion_covariance.hpp"
#include "common/geometry/unobserved_motion.hpp"
#include "integration/fusion_terms.hpp"
#include "integration/integration.hpp"

namespace zloam::integration {
namespace {

// The odometry's covariance of a step, scaled as a comparison with ground truth showed.
Matrix6 counted(const Matrix6& step, const IntegrationConfig& config) {
  Vector6 scale;
  scale << Eigen::Vector3d::Constant(config.step_scale_m),
      Eigen::Vector3d::Constant(config.step_scale_rad);
  return scale.asDiagonal() * finite_or_zero(step) * scale.asDiagonal();
}

// Age of the last matched correction beyond which a pose counts as Predicted. Mapping, at 10 Hz, is
// at most a few sweeps behind. A replay's corrections are as old as scheduled: there it counts only
// where mapping has matched nothing since.
constexpr std::int64_t kOldCorrection_ns = 1'000'000'000;

/// The odometry has matched the sweep: it then publishes what its source says of it.
bool is_followed(Health health) {
  return is_located(health) || health == Health::kIncomplete || health == Health::kTooFewPoints;
}

}  // namespace

// A degenerate direction of the correction is one of every pose that is derived from it, expressed
// in the axes of that pose.
Weak Integrator::weak_of(const OdometryPose& pose, const Correction& correction) const {
  Weak weak = correction.weak;
  for (const OdometryPose& p : recent_) {
    if (p.sweep != correction.sweep || p.odom_epoch != pose.odom_epoch) continue;
    const Eigen::Matrix3d R_now_then =
        pose.T_odom_base.linear().transpose() * p.T_odom_base.linear();
    weak.translation = R_now_then * weak.translation;
    weak.rotation = R_now_then * weak.rotation;
  }
  return weak;
}

// The map constrains the pose, and the odometry continues it over one or two sweeps: a degenerate
// odometry counts only as far as it increases the covariance of the pose.
Weak Integrator::judged(const OdometryPose& pose, const Correction* correction,
                        const Matrix6& covariance) const {
  if (correction == nullptr && pose.weak.degenerate) return pose.weak;
  if (correction != nullptr && correction->weak.degenerate) return weak_of(pose, *correction);
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> position;
  position.computeDirect(Eigen::Matrix3d(covariance.topLeftCorner<3, 3>()));
  const double worst_m = std::sqrt(std::max(0.0, position.eigenvalues()[2]));
  Weak weak;
  weak.sigma_measured = worst_m;
  weak.sigma_predicted = worst_m;
  weak.degenerate = worst_m > config_.drift_limit * kJudgedWay_m;
  if (weak.degenerate) weak.translation = position.eigenvectors().col(2);
  return weak;
}

// Health of the fused pose, from those of odometry and correction.
Health Integrator::health_of(const OdometryPose& pose, const Correction* correction,
                             const Weak& weak, bool uncorrected) const {
  const bool new_frame = pose.odom_epoch != first_epoch_.value_or(pose.odom_epoch);
  if (correction == nullptr) {
    if (new_frame) return Health::kBridging;
  } else if (correction->health == Health::kBridging || correction->health == Health::kLost) {
    return correction->health;
  }
  if (!is_located(pose.health)) return pose.health;
  // Its covariance has grown in every direction: none of them is the degenerate one.
  const bool unmatched = correction != nullptr && !is_located(correction->health);
  if (uncorrected && unmatched) return Health::kPredicted;
  if (weak.degenerate) return Health::kDegenerate;
  return uncorrected ? Health::kPredicted : Health::kOk;
}

Matrix6 Integrator::step_covariance(const OdometryPose& pose) const {
  if (mapped_ && mapped_->odom_epoch == pose.odom_epoch) {
    const double age_s = seconds(pose.instant_ns - mapped_->instant_ns);
    if (const auto lately = steps_.covariance(age_s)) return *lately;
  }
  return counted(pose.step_covariance, config_);
}

// Where the last motion leads, less certain by what the platform may have done unobserved.
Matrix6 Integrator::covariance_after_break(const OdometryPose& pose) const {
  const double gap_s = bridged_s(*last_odometry_, pose);
  const Pose T_now_last = exp_se3(-gap_s * last_odometry_->twist_per_s);
  return carried(last_fused_->covariance, T_now_last) +
         diagonal_covariance(0.5 * kUnobservedAcceleration_mps2 * gap_s * gap_s,
                             kUnobservedTurn_radps * gap_s);
}

Matrix6 Integrator::covariance_at(const OdometryPose& pose, const Correction* correction) {
  Matrix6 step = counted(pose.step_covariance, config_);
  const bool known =
      correction != nullptr && !recent_.empty() && recent_.front().sweep <= correction->sweep;
  if (!known) {
    if (!last_odometry_) return step;
    if (last_odometry_->odom_epoch != pose.odom_epoch) return covariance_after_break(pose) + step;
    const Pose back = pose.T_odom_base.inverse() * last_odometry_->T_odom_base;
    return carried(last_fused_->covariance, back) + step;
  }
  Matrix6 covariance = finite_or_zero(correction->covariance);
  const OdometryPose* from = nullptr;
  for (const OdometryPose& p : recent_) {
    if (p.sweep > correction->sweep && from != nullptr) {
      covariance =
          carried(covariance, p.T_odom_base.inverse() * from->T_odom_base) + step_covariance(p);
    }
    if (p.sweep >= correction->sweep) from = &p;
  }
  return covariance;
}

// One of the two is wrong where the map contradicts an odometry that has been right so far, and
// which one is not known: the pose may be off by all of their difference.
Matrix6 Integrator::contradiction_at(const OdometryPose& pose, const Correction* correction) const {
  Matrix6 covariance = Matrix6::Zero();
  if (correction == nullptr || !mapped_ || mapped_->sweep != correction->sweep) return covariance;
  const Eigen::Vector3d off_m =
      pose.T_odom_base.linear().transpose() * mapped_->T_odom_base.linear() * contradiction_m_;
  covariance.topLeftCorner<3, 3>() = off_m * off_m.transpose();
  return covariance;
}

// The way to or from a pose that nothing measured is not a motion that was seen.
bool Integrator::is_measured(const OdometryPose& pose, const Correction* correction,
                             bool uncorrected) const {
  const bool old_frame = pose.odom_epoch == first_epoch_.value_or(pose.odom_epoch);
  const bool by_map = correction == nullptr ? old_frame : is_located(correction->health);
  return is_followed(pose.health) && by_map && !uncorrected;
}

// A step that nothing explains may be an acceleration without example or an error of its own size,
// which is then the bound of three sigmas.
Matrix6 Integrator::own_motion_at(const FusedPose& fused, bool measured) {
  Matrix6 covariance = Matrix6::Zero();
  if (!measured) {
    own_motion_.forget_motion();
    return covariance;
  }
  const Eigen::Vector3d off_m =
      own_motion_.unexplained_m(fused.instant_ns, fused.T_map_base, fused.covariance);
  covariance.topLeftCorner<3, 3>() = off_m * off_m.transpose() / 9.0;
  return covariance;
}

// Before the first correction the age counts from the run's first pose, which is as certain as the
// map's frame itself.
bool Integrator::old(const OdometryPose& pose, const Correction* correction) {
  if (!corrected_ns_) corrected_ns_ = pose.instant_ns;
  const bool unmatched = correction != nullptr && !is_located(correction->health);
  if (correction != nullptr && !unmatched) {
    for (const OdometryPose& p : recent_) {
      if (p.sweep == correction->sweep) corrected_ns_ = std::max(*corrected_ns_, p.instant_ns);
    }
  }
  return (!pose.replay || unmatched) && pose.instant_ns - *corrected_ns_ > kOldCorrection_ns;
}

}  // namespace zloam::integration
