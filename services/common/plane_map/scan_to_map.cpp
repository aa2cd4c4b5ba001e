#include "common/plane_map/scan_to_map.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/motion_covariance.hpp"

namespace zloam::plane_map {
namespace {

// The gate is a slow mean, computed from the predictions' errors and a margin.
constexpr double kGateMemory = 0.9;
constexpr double kGateMargin_m = 0.05;
// Slow mean of the normals' share along the least constrained direction. It spans more than the
// passage of a door, where for half a second hardly anything constrains that direction.
constexpr double kShareMemory = 0.95;
// A sweep directly follows the last one if it begins within this share of a period of that one's
// end.
constexpr double kAdjoining = 0.1;

double squared(double x) { return x * x; }

double seconds(std::uint32_t period_ns) { return std::max<double>(period_ns, 1.0) * 1e-9; }

// Unset or singular covariances carry no information.
Matrix6 inverse_or_zero(const Matrix6& covariance) {
  const Eigen::LDLT<Matrix6> ldlt(covariance);
  if (!covariance.allFinite() || ldlt.info() != Eigen::Success ||
      ldlt.vectorD().minCoeff() <= 0.0) {
    return Matrix6::Zero();
  }
  return ldlt.solve(Matrix6::Identity());
}

// The mean of both predictions, weighted by their information: one Gauss-Newton step from the
// second one (odometry's).
SweepMotion most_likely(const MotionPrior& prior) {
  Matrix12 h = Matrix12::Zero();
  Vector12 g = Vector12::Zero();
  add_priors(prior, prior.advised, h, g);
  const Vector12 step = -h.ldlt().solve(g);
  if (!step.allFinite()) return prior.advised;
  SweepMotion out = prior.advised;
  out.T_mid = normalised(out.T_mid * exp_se3(step.head<6>()));
  out.twist += step.tail<6>();
  return out;
}

// For a platform known to be at rest: sets the twist to zero and returns the covariance with that
// knowledge.
Matrix12 held_still(const Matrix12& covariance, double period_s, SweepMotion& motion) {
  motion.twist.setZero();
  Matrix12 out = covariance;
  out.topRightCorner<6, 6>().setZero();
  out.bottomLeftCorner<6, 6>().setZero();
  out.bottomRightCorner<6, 6>() =
      diagonal_covariance(kRestSpeed_mps * period_s, kRestRate_radps * period_s);
  return out;
}

}  // namespace

Pose ScanToMapResult::at(std::uint32_t instant_ns, std::uint32_t period_ns) const {
  const double period_s = seconds(period_ns);
  const double s = instant_ns * 1e-9 / period_s - 0.5;  // in sweeps from the middle
  return normalised(T_map_base_mid *
                    exp_se3(period_s * (s * twist_per_s + 0.5 * s * s * twist_change_per_s)));
}

// The pose at s is T_mid * Exp(s * twist): its perturbation is that of T_mid, transformed to s,
// plus s times that of the twist.
Matrix6 ScanToMapResult::covariance_at(std::uint32_t instant_ns, std::uint32_t period_ns) const {
  const double since_mid_s = instant_ns * 1e-9 - 0.5 * seconds(period_ns);
  Eigen::Matrix<double, 6, 12> jacobian;
  jacobian << adjoint(exp_se3(-since_mid_s * twist_per_s)), since_mid_s * Matrix6::Identity();
  const double period_s = seconds(period_ns);
  const double of_bend = 0.5 * squared(since_mid_s / period_s);
  Eigen::Matrix<double, 6, 12> by_motion = bend.by_motion;
  by_motion.rightCols<6>() *= period_s;
  jacobian -= of_bend * by_motion;
  return jacobian * covariance * jacobian.transpose() + squared(of_bend) * bend.own_covariance;
}

ScanToMap::ScanToMap(const PlaneMapConfig& map, const MatcherConfig& matcher,
                     const Pose& T_map_base_start)
    : config_(matcher),
      map_(map),
      matcher_(matcher),
      T_grid_base_start_(map_.T_grid_map() * T_map_base_start),
      gate_m_(matcher.max_gate_m) {}

Vector6 ScanToMap::previous_twist_per_s() const {
  return previous_ ? Vector6(previous_->motion.twist / seconds(previous_->period_ns))
                   : Vector6(Vector6::Zero());
}

// From one mid-sweep to the next the body moves by the mean of both twists; the twist changes at
// random by `change` (white acceleration). The previous pose and twist enter with their joint
// covariance, as their errors are correlated: trusting either fully causes a zig-zag, in which the
// error of one sweep's twist returns with the opposite sign in the next.
Matrix12 ScanToMap::carried_on(double steps, double rate) const {
  const Matrix12 before = bounded();
  Matrix12 F = Matrix12::Zero();
  F.topLeftCorner<6, 6>() = adjoint(exp_se3(-steps * previous_->motion.twist));
  F.topRightCorner<6, 6>() = steps * Matrix6::Identity();
  F.bottomRightCorner<6, 6>() = rate * Matrix6::Identity();
  const Matrix6 change = this->change(steps);
  const Matrix6 cross = 0.5 * rate * steps * change;
  Matrix12 grown;
  grown << squared(steps) * (0.25 * change + continuity()), cross, cross, squared(rate) * change;
  return F * before * F.transpose() + grown;
}

// The map was built from the poses, so relative to it a pose is known to pose_sigma_*.
Matrix12 ScanToMap::bounded() const {
  return with_bounded_pose_at(previous_->seen_at, previous_->motion.twist, previous_->covariance,
                              diagonal_covariance(config_.pose_sigma_m, config_.pose_sigma_rad));
}

// Covariance of the twist's change over this many sweeps: white acceleration, and the recorded
// accelerations.
Matrix6 ScanToMap::change(double steps) const {
  const double period_s = seconds(previous_->period_ns);
  return steps * diagonal_covariance(config_.change_sigma_m, config_.change_sigma_rad) +
         squared(steps * period_s * period_s) * acceleration_.covariance();
}

// Covariance of the motion between two mid-sweeps about the mean of both sweeps' motions.
Matrix6 ScanToMap::continuity() const {
  const Vector6 bend = config_.continuity_share * previous_->twist_change;
  return diagonal_covariance(config_.continuity_sigma_m + bend.head<3>().norm(),
                             config_.continuity_sigma_rad + bend.tail<3>().norm());
}

bool ScanToMap::adjoins(const SweepInput& sweep) const {
  const auto between_ns = static_cast<double>(sweep.stamp_ns - previous_->stamp_ns);
  return std::abs(between_ns - previous_->period_ns) < kAdjoining * previous_->period_ns;
}

// Predicts the motion from the IMU: from the end of the sweep before, with its velocity plus the
// preintegrated change, and with the preintegrated rotation.
void ScanToMap::foresee(const SweepInput& sweep, MotionPrior& prior) const {
  const InertialStep& step = *sweep.inertial;
  const double last_s = seconds(previous_->period_ns);
  const double now_s = seconds(sweep.period_ns);
  const Vector6& before = previous_->motion.twist;
  prior.predicted.twist = twist_after(step, before, last_s, now_s);
  prior.predicted.T_mid = previous_->motion.at(0.5) * exp_se3(0.5 * prior.predicted.twist);

  const Matrix6 by_twist = twist_after_jacobian(step, before, last_s, now_s);
  Matrix12 F = Matrix12::Zero();
  F.topLeftCorner<6, 6>() = adjoint(exp_se3(-0.5 * prior.predicted.twist) * exp_se3(-0.5 * before));
  F.topRightCorner<6, 6>() = 0.5 * (Matrix6::Identity() + by_twist);
  F.bottomRightCorner<6, 6>() = by_twist;
  Vector6 units = Vector6::Ones();
  units.head<3>().setConstant(now_s);
  const Matrix6 change = units.asDiagonal() * step.covariance * units.asDiagonal();
  Matrix12 grown;
  grown << 0.25 * change + continuity(), 0.5 * change, 0.5 * change, change;
  const Matrix12 known = with_twist_of(bounded(), previous_->covariance);
  Matrix12 covariance = F * known * F.transpose() + grown;
  if (step.at_rest) covariance = held_still(covariance, now_s, prior.predicted);
  prior.usual_information = prior.information;
  prior.information = covariance.ldlt().solve(Matrix12::Identity());
}

MotionPrior ScanToMap::make_prior(const SweepInput& sweep,
                                  const std::optional<MotionPrediction>& prediction) const {
  MotionPrior prior;
  prior.predicted.T_mid = T_grid_base_start_;
  if (previous_ && !(prediction && prediction->use == PredictionUse::kInstead)) {
    const double last_s = seconds(previous_->period_ns);
    const double now_s = seconds(sweep.period_ns);
    const double since_s =
        std::max(static_cast<double>(sweep.stamp_ns - previous_->stamp_ns) * 1e-9, 0.5 * last_s);
    const double steps = std::max(0.5, (since_s + 0.5 * (now_s - last_s)) / last_s);
    prior.predicted.T_mid = previous_->motion.T_mid * exp_se3(steps * previous_->motion.twist);
    prior.predicted.twist = previous_->motion.twist * (now_s / last_s);
    const double rate = now_s / last_s;
    prior.bend_sigma = squared(now_s) * acceleration_.covariance().diagonal().cwiseSqrt();
    prior.information = carried_on(steps, rate).ldlt().solve(Matrix12::Identity());
    if (sweep.inertial && adjoins(sweep)) foresee(sweep, prior);
  }
  if (weak_) {
    prior.weak_axis_grid = prior.predicted.T_mid.linear() * weak_axis_base_;
  }
  prior.start = prior.predicted;
  if (prediction) {
    add_prediction(sweep, *prediction, prior);
  }
  return prior;
}

void ScanToMap::add_prediction(const SweepInput& sweep, const MotionPrediction& prediction,
                               MotionPrior& prior) const {
  const double period_s = seconds(sweep.period_ns);
  const double to_mid_s = 0.5 * period_s - prediction.instant_ns * 1e-9;
  prior.advised.T_mid =
      map_.T_grid_map() * prediction.T_map_base * exp_se3(to_mid_s * prediction.twist_per_s);
  prior.advised.twist = prediction.twist_per_s * period_s;
  prior.advice_information.block<6, 6>(0, 0) = inverse_or_zero(prediction.pose_covariance);
  prior.advice_information.block<6, 6>(6, 6) =
      inverse_or_zero(prediction.twist_covariance * squared(period_s));
  prior.start = prior.advised;
  if (previous_ && prediction.use == PredictionUse::kBeside) {
    prior.start = most_likely(prior);
    prior.advice_information.setZero();
  }
}

double ScanToMap::disagreement(const SweepInput& sweep, const MotionPrediction& prediction) const {
  if (!previous_) return 0.0;
  const MotionPrior prior = make_prior(sweep, prediction);
  const Matrix6 own = prior.information.ldlt().solve(Matrix12::Identity()).topLeftCorner<6, 6>();
  const Vector6 apart = log_se3(prior.predicted.T_mid.inverse() * prior.advised.T_mid);
  return apart.dot((own + prediction.pose_covariance).ldlt().solve(apart));
}

MatchResult ScanToMap::match(const SweepPoints& points, const MotionPrior& prior) {
  map_.set_anchor(prior.start.T_mid.translation());
  const Gate first{gate_m_, gate_m_ / 3.0, config_.crowd_points};
  return matcher_.match(map_, points, prior, {first, share_});
}

void ScanToMap::insert(const SweepInput& sweep, const SweepMotion& motion) {
  const Thinning thinning{stride_to(config_.enough_inserted_points, sweep.size()), sweeps_,
                          kCountedTogether};
  take_points(sweep, config_.min_range_m, thinning, inserted_points_);
  map_.set_anchor(motion.T_mid.translation());
  // Matched and inserted points of a sweep have the same motion.
  const SlotMotions motions =
      matched_points_of(sweep).motions(motion.T_mid.linear(), motion.twist, motion.bend);
  const Eigen::Vector3f shift = (motion.T_mid.translation() - map_.anchor_grid()).cast<float>();
  to_local(inserted_points_, motions, shift, inserted_);
  map_.insert(inserted_);
  map_.leave_behind(motion.T_mid.translation());
}

void ScanToMap::follow_gate(const ScanToMapResult& result) {
  const double wanted = 3.0 * (result.prediction_error_m + kGateMargin_m);
  gate_m_ = std::clamp(kGateMemory * gate_m_ + (1.0 - kGateMemory) * wanted, config_.min_gate_m,
                       config_.max_gate_m);
  const double share = result.degeneracy.share;
  share_ = share_ ? kShareMemory * *share_ + (1.0 - kShareMemory) * share : share;
}

ScanToMapResult ScanToMap::result_of(const MatchResult& match, const SweepInput& sweep) const {
  const double period_s = seconds(sweep.period_ns);
  const Pose T_map_grid = map_.T_grid_map().inverse();
  ScanToMapResult out;
  out.outcome = match.valid ? Outcome::kMatched : Outcome::kPredicted;
  out.T_map_base_mid = normalised(T_map_grid * match.motion.T_mid);
  out.twist_per_s = match.motion.twist / period_s;
  out.twist_change_per_s = match.motion.bend / period_s;
  out.T_map_base_end = out.at(sweep.period_ns, sweep.period_ns);
  out.covariance = with_twist_scaled(match.covariance, 1.0 / period_s);
  out.seen_at = match.seen_at;
  out.bend = match.bend;
  out.degeneracy = match.degeneracy;
  out.residual_rms_m = match.residual_rms_m;
  out.inlier_rms_m = match.inlier_rms_m;
  out.matched_fraction = match.matched_fraction;
  out.matched_weight = match.matched_weight;
  out.explained_weight = match.explained_weight;
  out.gate_m = gate_m_;
  out.iterations = match.iterations;
  out.converged = match.converged;
  out.tried = match.tried;
  out.matches = match.matches;
  return out;
}

const SweepPoints& ScanToMap::matched_points_of(const SweepInput& sweep) {
  if (matched_stamp_ns_ != sweep.stamp_ns) {
    const std::size_t enough = stride_to(config_.enough_points, sweep.size());
    const Thinning thinning{std::max<std::size_t>(config_.stride, enough), sweeps_ * 7};
    matched_points_.set(sweep, config_.min_range_m, thinning);
    matched_stamp_ns_ = sweep.stamp_ns;
  }
  return matched_points_;
}

ScanToMapResult ScanToMap::match(const SweepInput& sweep,
                                 const std::optional<MotionPrediction>& prediction) {
  const SweepPoints& points = matched_points_of(sweep);
  const MotionPrior prior = make_prior(sweep, prediction);
  MatchResult match;
  match.motion = prior.start;
  if (!map_.empty()) {
    match = this->match(points, prior);
  }
  Degeneracy& d = match.degeneracy;
  // Hysteresis: a degenerate direction stays so until it is clearly constrained.
  d.weak =
      match.valid && (d.weak || (weak_ && d.measured_sigma_m > kStrongRatio * d.predicted_sigma_m));
  ScanToMapResult result = result_of(match, sweep);
  const Vector6 error = log_se3(prior.start.T_mid.inverse() * match.motion.T_mid);
  result.prediction_error_m =
      error.head<3>().norm() + 2.0 * config_.gate_range_m * std::sin(0.5 * error.tail<3>().norm());
  result.points = sweep.size();
  if (map_.empty() && points.points().size() >= config_.min_matches) {
    result.outcome = Outcome::kStarted;
  }
  return result;
}

void ScanToMap::commit(const SweepInput& sweep, const ScanToMapResult& result, bool insert) {
  SweepMotion motion;
  motion.T_mid = map_.T_grid_map() * result.T_map_base_mid;
  motion.twist = result.twist_per_s * seconds(sweep.period_ns);
  motion.bend = result.twist_change_per_s * seconds(sweep.period_ns);
  if (result.outcome == Outcome::kMatched) {
    follow_gate(result);
    weak_ = result.degeneracy.weak;
    weak_axis_base_.setZero();
    if (result.degeneracy.second_share >= config_.walls_least_share) {
      weak_axis_base_ = result.degeneracy.axis;
    }
  } else {
    share_ = 0.0;
  }
  if (insert) {
    if (map_.empty()) share_.reset();
    this->insert(sweep, motion);
  }
  if (previous_ || !map_.empty()) remember(sweep, result, motion);
  matched_stamp_ns_.reset();
  ++sweeps_;
}

bool ScanToMap::insert_again(const SweepInput& sweep) {
  if (!previous_ || previous_->stamp_ns != sweep.stamp_ns || sweeps_ == 0) return false;
  matched_stamp_ns_.reset();
  // The thinning depends on the number of sweeps before this one.
  --sweeps_;
  insert(sweep, previous_->motion);
  ++sweeps_;
  matched_stamp_ns_.reset();
  return true;
}

std::optional<ScanToMapResult> ScanToMap::last_motion() const {
  if (!previous_) return std::nullopt;
  const double period_s = seconds(previous_->period_ns);
  ScanToMapResult out;
  out.T_map_base_mid = normalised(map_.T_grid_map().inverse() * previous_->motion.T_mid);
  out.twist_per_s = previous_->motion.twist / period_s;
  out.twist_change_per_s = previous_->motion.bend / period_s;
  return out;
}

void ScanToMap::remember(const SweepInput& sweep, const ScanToMapResult& result,
                         const SweepMotion& motion) {
  // Residuals above the noise model: inflate the covariance by (residual / noise)^2.
  const double off = std::max(1.0, result.residual_rms_m / map_.config().range_noise_m);
  const Matrix12 covariance =
      squared(off) * with_twist_scaled(result.covariance, seconds(sweep.period_ns));
  Vector6 change = Vector6::Zero();
  if (previous_) {
    change = motion.twist - previous_->motion.twist;
    if (result.outcome == Outcome::kMatched) {
      learn_acceleration(sweep, result, squared(off) * result.covariance);
    }
  }
  previous_ = Previous{motion, covariance, result.seen_at, change, sweep.stamp_ns, sweep.period_ns};
}

// covariance: that of (pose, twist per second)
void ScanToMap::learn_acceleration(const SweepInput& sweep, const ScanToMapResult& result,
                                   const Matrix12& covariance) {
  const double between_s = 1e-9 * static_cast<double>(sweep.stamp_ns - previous_->stamp_ns);
  if (!(between_s > 0.0)) return;
  const Matrix12 before =
      with_twist_scaled(previous_->covariance, 1.0 / seconds(previous_->period_ns));
  const Matrix6 errors = (before + covariance).bottomRightCorner<6, 6>() / squared(between_s);
  acceleration_.add(unexplained((result.twist_per_s - previous_twist_per_s()) / between_s, errors));
}

void ScanToMap::configure(const MatcherConfig& matcher) {
  config_ = matcher;
  matcher_ = SweepMatcher(matcher);
}

ScanToMapResult ScanToMap::process(const SweepInput& sweep,
                                   const std::optional<MotionPrediction>& prediction) {
  ScanToMapResult result = match(sweep, prediction);
  commit(sweep, result, result.outcome != Outcome::kPredicted);
  return result;
}

}  // namespace zloam::plane_map
