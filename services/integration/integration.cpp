#include "integration/integration.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/geometry/motion_covariance.hpp"
#include "common/geometry/state_bits.hpp"
#include "common/geometry/unobserved_motion.hpp"

namespace zloam::integration {
namespace {

// Maximum number of kept odometry poses, which carry a correction's covariance to the present, and
// of kept corrections.
constexpr std::size_t kRecent = 256;
// Maximum number of odometry poses in a saved state, if a scheduled correction needs no more.
constexpr std::size_t kSaved = 32;

Matrix6 finite_or_zero(const Matrix6& covariance) {
  if (!covariance.allFinite()) return Matrix6::Zero();
  return 0.5 * (covariance + covariance.transpose());
}

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

/// The pose was measured, at least along some directions.
bool is_located(Health health) { return health == Health::kOk || health == Health::kDegenerate; }

/// The odometry has matched the sweep: it then publishes what its source says of it.
bool is_followed(Health health) {
  return is_located(health) || health == Health::kIncomplete || health == Health::kTooFewPoints;
}

MappedPose mapped_pose(const OdometryPose& pose, const Correction& correction) {
  return {pose.sweep,
          pose.odom_epoch,
          pose.instant_ns,
          normalised(correction.T_map_odom * pose.T_odom_base),
          pose.T_odom_base,
          finite_or_zero(correction.covariance),
          is_located(correction.health)};
}

/// A replay's next pose is carried on from its scheduled correction, so many poses before.
std::size_t most_saved(const IntegrationConfig& config) {
  return std::max<std::size_t>(kSaved, config.mapping_every + config.correction_delay);
}

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

/// Time over which the motion before an interruption is continued.
double bridged_s(const OdometryPose& before, const OdometryPose& after) {
  return std::clamp(seconds(after.instant_ns - before.instant_ns), 0.0, kLongestGap_s);
}

}  // namespace

std::optional<std::uint64_t> scheduled_correction(std::uint64_t sweep,
                                                  const IntegrationConfig& config) {
  if (sweep < config.correction_delay) return std::nullopt;
  const std::uint64_t every = std::max<std::uint32_t>(config.mapping_every, 1);
  return (sweep - config.correction_delay) / every * every;
}

Integrator::Integrator(const IntegrationConfig& config) : config_(config) {}

void Integrator::reset() { *this = Integrator(config_); }

void Integrator::new_run() {
  newest_pose_.reset();
  corrected_ns_.reset();
  contradiction_m_.setZero();
  own_motion_.forget_motion();
  waiting_.clear();
  corrections_.clear();
  recent_.clear();
}

void Integrator::restore(const OdometryPose& pose, const Pose& T_map_base) {
  reset();
  own_motion_.begun_before();
  newest_pose_ = pose.sweep;
  first_epoch_ = pose.odom_epoch;
  last_odometry_ = pose;
  last_fused_ = FusedPose{};
  last_fused_->T_map_base = T_map_base;
  last_T_map_odom_ = normalised(T_map_base * pose.T_odom_base.inverse());
}

std::vector<std::uint64_t> Integrator::state() const {
  // Later poses need nothing from before the last mapped pose.
  const std::uint64_t from = mapped_ ? mapped_->sweep : 0;
  Integrator kept(config_);
  kept.mapped_ = mapped_;
  kept.contradiction_m_ = contradiction_m_;
  kept.steps_ = steps_;
  kept.own_motion_ = own_motion_;
  kept.last_odometry_ = last_odometry_;
  kept.last_fused_ = last_fused_;
  kept.last_T_map_odom_ = last_T_map_odom_;
  kept.first_epoch_ = first_epoch_;
  kept.corrected_ns_ = corrected_ns_;
  for (const OdometryPose& pose : recent_) {
    if (pose.sweep >= from) kept.recent_.push_back(pose);
  }
  while (kept.recent_.size() > most_saved(config_)) kept.recent_.pop_front();
  for (auto it = corrections_.lower_bound(from); it != corrections_.end(); ++it) {
    kept.corrections_.insert(*it);
  }
  StateBits bits;
  kept.each(bits);
  return bits.take();
}

bool Integrator::resume(std::span<const std::uint64_t> state) {
  reset();
  StateBits bits(state);
  each(bits);
  if (!bits.complete() || !last_fused_ || !last_odometry_) {
    reset();
    return false;
  }
  newest_pose_ = last_fused_->sweep;
  return true;
}

std::vector<FusedPose> Integrator::add(const OdometryPose& pose) {
  if (newest_pose_ && pose.sweep <= *newest_pose_) return {};
  newest_pose_ = pose.sweep;
  waiting_.push_back(pose);
  return release();
}

std::vector<FusedPose> Integrator::add(const Correction& correction) {
  if (!correction.T_map_odom.matrix().allFinite()) return {};
  corrections_.emplace(correction.sweep, correction);
  return release();
}

std::optional<std::uint64_t> Integrator::awaited() const {
  if (waiting_.empty()) return std::nullopt;
  return scheduled_correction(waiting_.front().sweep, config_);
}

bool Integrator::can_leave(const OdometryPose& pose) const {
  if (!pose.replay) return true;
  const auto scheduled = scheduled_correction(pose.sweep, config_);
  return !scheduled || corrections_.contains(*scheduled);
}

std::vector<FusedPose> Integrator::release() {
  std::vector<FusedPose> poses;
  while (!waiting_.empty() && can_leave(waiting_.front())) {
    poses.push_back(fuse(waiting_.front()));
    waiting_.pop_front();
  }
  return poses;
}

const Correction* Integrator::correction_for(const OdometryPose& pose) const {
  if (pose.replay) {
    const auto scheduled = scheduled_correction(pose.sweep, config_);
    if (!scheduled) return nullptr;
    const auto found = corrections_.find(*scheduled);
    const bool fits = found != corrections_.end() && found->second.odom_epoch == pose.odom_epoch;
    return fits ? &found->second : nullptr;
  }
  // When poses are caught up with after a restart, corrections of later sweeps are there already:
  // T_map_odom has rotated since and would rotate the pose about a distant origin.
  const Correction* newer = nullptr;
  for (auto it = corrections_.rbegin(); it != corrections_.rend(); ++it) {
    if (it->second.odom_epoch != pose.odom_epoch) continue;
    if (it->first <= pose.sweep) return &it->second;
    newer = &it->second;
  }
  return newer;
}

// Learns from each correction, once, the errors of both predictions of its pose.
void Integrator::follow_map(const Correction& correction) {
  if (mapped_ && mapped_->sweep == correction.sweep) return;
  for (const OdometryPose& p : recent_) {
    if (p.sweep != correction.sweep || p.odom_epoch != correction.odom_epoch) continue;
    const MappedPose now = mapped_pose(p, correction);
    contradiction_m_.setZero();
    if (now.located && mapped_ && mapped_->odom_epoch == now.odom_epoch &&
        mapped_->sweep < now.sweep) {
      const Pose by_map = mapped_->T_map_base.inverse() * now.T_map_base;
      const Pose by_odometry = mapped_->T_odom_base.inverse() * now.T_odom_base;
      const Matrix6 covariance = mapped_->covariance + now.covariance;
      const int sweeps = static_cast<int>(now.sweep - mapped_->sweep);
      // A step from a pose that the map did not measure is not what the map says.
      if (mapped_->located) {
        contradiction_m_ = steps_.contradiction_m(by_map, covariance, by_odometry, sweeps);
      }
      steps_.observe(by_map, covariance, by_odometry, seconds(now.instant_ns - mapped_->instant_ns),
                     sweeps);
    } else {
      steps_.forget_motion();
    }
    mapped_ = now;
    return;
  }
}

Pose Integrator::step_between(const OdometryPose& from, const OdometryPose& to) const {
  Pose step = from.T_odom_base.inverse() * to.T_odom_base;
  if (!mapped_ || mapped_->odom_epoch != to.odom_epoch) return step;
  return steps_.step(step, to.weak, seconds(to.instant_ns - from.instant_ns),
                     seconds(to.instant_ns - mapped_->instant_ns));
}

std::optional<Pose> Integrator::carried_on(const OdometryPose& pose,
                                           const Correction& correction) const {
  std::optional<Pose> T_map_base;
  const OdometryPose* from = nullptr;
  for (const OdometryPose& p : recent_) {
    if (p.sweep > pose.sweep) break;
    if (p.sweep == correction.sweep) T_map_base = correction.T_map_odom * p.T_odom_base;
    if (p.sweep > correction.sweep && T_map_base)
      *T_map_base = *T_map_base * step_between(*from, p);
    from = &p;
  }
  return T_map_base;
}

void Integrator::place(const OdometryPose& pose, const Correction* correction, FusedPose& fused) {
  const bool broken_off = last_odometry_ && last_odometry_->odom_epoch != pose.odom_epoch;
  Pose T_map_odom = last_T_map_odom_.value_or(Pose::Identity());
  std::optional<Pose> T_map_base;
  if (correction != nullptr) {
    follow_map(*correction);
    T_map_odom = correction->T_map_odom;
    T_map_base = carried_on(pose, *correction);
  } else if (broken_off) {
    // The new frame starts where the last pose has moved according to its twist.
    const double gap_s = bridged_s(*last_odometry_, pose);
    const Pose T_map_end = last_fused_->T_map_base * exp_se3(last_odometry_->twist_per_s * gap_s);
    T_map_odom = normalised(T_map_end * pose.T_odom_base.inverse());
  }
  fused.T_map_base = normalised(T_map_base.value_or(T_map_odom * pose.T_odom_base));
  if (last_fused_ && !broken_off) {
    const Pose expected = last_fused_->T_map_base * step_between(*last_odometry_, pose);
    const Vector6 step = log_se3(expected.inverse() * fused.T_map_base);
    fused.jump = step.head<3>().norm() > config_.jump_m || step.tail<3>().norm() > config_.jump_rad;
  } else if (broken_off) {
    fused.jump = true;
  }
  last_T_map_odom_ = T_map_odom;
}

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
                             const Weak& weak) {
  const bool uncorrected = old(pose, correction);
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

// One of the two is wrong where the map contradicts an odometry that has been right so far, and which
// one is not known: the pose may be off by all of their difference.
Matrix6 Integrator::contradiction_at(const OdometryPose& pose, const Correction* correction) const {
  Matrix6 covariance = Matrix6::Zero();
  if (correction == nullptr || !mapped_ || mapped_->sweep != correction->sweep) return covariance;
  const Eigen::Vector3d off_m =
      pose.T_odom_base.linear().transpose() * mapped_->T_odom_base.linear() * contradiction_m_;
  covariance.topLeftCorner<3, 3>() = off_m * off_m.transpose();
  return covariance;
}

// The way to or from a pose that nothing measured is not a motion that was seen.
bool Integrator::is_measured(const OdometryPose& pose, const Correction* correction) {
  const bool old_frame = pose.odom_epoch == first_epoch_.value_or(pose.odom_epoch);
  const bool by_map = correction == nullptr ? old_frame : is_located(correction->health);
  return is_followed(pose.health) && by_map && !old(pose, correction);
}

// A step that nothing explains may be an acceleration without example or an error of its own size,
// which is then the bound of three sigmas.
Matrix6 Integrator::own_motion_at(const OdometryPose& pose, const Correction* correction,
                                  const FusedPose& fused) {
  Matrix6 covariance = Matrix6::Zero();
  if (!is_measured(pose, correction)) {
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

FusedPose Integrator::fuse(const OdometryPose& pose) {
  const Correction* correction = correction_for(pose);
  if (!recent_.empty() && recent_.back().odom_epoch != pose.odom_epoch) {
    recent_.clear();
    own_motion_.forget_motion();
  }
  recent_.push_back(pose);
  FusedPose fused;
  fused.sweep = pose.sweep;
  fused.instant_ns = pose.instant_ns;
  fused.twist_per_s = pose.twist_per_s;
  fused.covariance = covariance_at(pose, correction);
  place(pose, correction, fused);
  fused.covariance += contradiction_at(pose, correction);
  const Matrix6 without_own_motion = fused.covariance;
  fused.covariance += own_motion_at(pose, correction, fused);
  fused.has_correction = correction != nullptr;
  fused.correction_sweep = correction != nullptr ? correction->sweep : 0;
  fused.weak = judged(pose, correction, fused.covariance);
  fused.health = health_of(pose, correction, fused.weak);
  if (!first_epoch_) first_epoch_ = pose.odom_epoch;
  last_odometry_ = pose;
  last_fused_ = fused;
  // It is the doubt about one step: the next step confirms it, or is doubted itself.
  last_fused_->covariance = without_own_motion;
  forget();
  return fused;
}

// Drops what no later pose can need.
void Integrator::forget() {
  while (recent_.size() > kRecent) recent_.pop_front();
  if (last_odometry_->replay) {
    const auto scheduled = scheduled_correction(last_odometry_->sweep, config_);
    if (scheduled) corrections_.erase(corrections_.begin(), corrections_.lower_bound(*scheduled));
    while (!recent_.empty() && scheduled && recent_.front().sweep < *scheduled) {
      recent_.pop_front();
    }
    return;
  }
  while (corrections_.size() > kRecent) corrections_.erase(corrections_.begin());
}

}  // namespace zloam::integration
