#include "integration/integration.hpp"

#include <algorithm>

#include "common/geometry/state_bits.hpp"
#include "integration/fusion_terms.hpp"

namespace zloam::integration {
namespace {

// Maximum number of kept odometry poses, which carry a correction's covariance to the present, and
// of kept corrections.
constexpr std::size_t kRecent = 256;
// Maximum number of odometry poses in a saved state, if a scheduled correction needs no more.
constexpr std::size_t kSaved = 32;

MappedPose mapped_pose(const OdometryPose& pose, const Correction& correction) {
  return {pose.sweep,
          correction.map_id,
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
  kept.drift_ = drift_;
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
    watch_odometry(now, correction);
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

// A pose that the map leaves open along a direction says nothing of the odometry.
void Integrator::watch_odometry(const MappedPose& now, const Correction& correction) {
  const bool follows = mapped_ && mapped_->odom_epoch == now.odom_epoch &&
                       mapped_->map_id == now.map_id && now.located;
  if (!follows) drift_.forget();
  if (correction.health != Health::kOk || correction.weak.degenerate) return;
  drift_.add(now.T_map_base, now.T_odom_base, now.covariance.topLeftCorner<3, 3>());
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
  const bool uncorrected = old(pose, correction);
  fused.covariance += own_motion_at(fused, is_measured(pose, correction, uncorrected));
  fused.has_correction = correction != nullptr;
  fused.correction_sweep = correction != nullptr ? correction->sweep : 0;
  fused.weak = judged(pose, correction, fused.covariance);
  fused.health = health_of(pose, correction, fused.weak, uncorrected);
  fused.odometry_drift_m = drift_.drift_m();
  fused.odometry_way_m = drift_.way_m();
  fused.odometry_drifts = drift_.exceeds(config_.drift_limit * kJudgedWay_m);
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
