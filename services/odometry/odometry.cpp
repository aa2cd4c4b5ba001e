#include "odometry/odometry.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/geometry/deskew.hpp"
#include "common/geometry/error_record.hpp"
#include "common/geometry/fit_record.hpp"
#include "common/geometry/motion_covariance.hpp"
#include "odometry/knot_odometry.hpp"
#include "odometry/matcher.hpp"
#include "odometry/motion_prediction.hpp"
#include "odometry/start.hpp"

namespace zloam::odometry {
namespace {

// Number of other starts from which the matching is run to its end.
constexpr std::size_t kTried = 2;
// Cost relative to the usual one: right matches that have not converged have up to 1.2, wrong ones
// 1.3 and more (docs/experiments/2026-11-26-lost-by-fit.md).
constexpr double kWorse = 1.5;
// Sweeps of another place cost ten times the usual, even if the match has converged.
constexpr double kFarWorse = 5.0;
// Only a sweep without points may have a shorter period, or none (messages/ranges.cpp): over no
// time at all, a motion has neither a rate nor a covariance.
constexpr std::uint32_t kLeastPeriod_ns = 1'000'000;

FeatureSweep with_period(FeatureSweep sweep) {
  sweep.period_ns = std::max(sweep.period_ns, kLeastPeriod_ns);
  return sweep;
}

PointVector moved_by(const std::vector<MotionLanes>& motions, const DeskewTable& table,
                     PointSpan points) {
  PointVector out;
  out.reserve(points.size());
  for (const Point& p : points) {
    if (is_usable(p)) {
      const Float4 q = motions[table.step_at(p.time_ns)](p.x, p.y, p.z);
      out.push_back({q[0], q[1], q[2], p.intensity, p.time_ns, p.ring, p.return_type, p.reserved});
    }
  }
  return out;
}

bool is_matched(Health health) { return health == Health::kOk || health == Health::kDegenerate; }

bool is_a_match(const CommittedSweep& sweep) { return is_matched(sweep.health); }

OdometryResult result_of(const CommittedSweep& sweep) {
  OdometryResult result;
  result.sweep = sweep.sweep;
  result.prev_sweep = sweep.prev_sweep;
  result.instant_ns = sweep.instant_ns;
  result.T_odom_base = sweep.T_odom_base;
  result.twist_per_s = sweep.twist_per_s;
  result.health = sweep.health;
  result.state_covariance = sweep.state_covariance;
  result.inertia = sweep.inertia;
  result.fit = sweep.fit;
  result.planes.assign(sweep.planes.begin(), sweep.planes.end());
  return result;
}

}  // namespace

struct Odometry::State : MotionMemory {
  State(const OdometryConfig& c, const Pose& mounting, const Pose& imu_mounting)
      : config(c),
        T_base_lidar(mounting),
        T_base_imu(imu_mounting),
        recent(c, 0.02),
        inertial(imu_mounting) {}

  OdometryConfig config;
  Pose T_base_lidar;
  Pose T_base_imu;
  WindowMap recent;
  InertialAid inertial;
  FitRecord fits;
  /// for scans that arrive in slices
  std::optional<KnotOdometry> knots;

  // The first sweep was a part of a revolution and did not initialize the target.
  bool passed_piece = false;
  std::uint64_t prev_sweep = 0;
  // The sweep that initialized the target while the twist was unknown, to be deskewed once the
  // twist is known.
  PointVector founding_planes;
  std::uint32_t founding_period_ns = 0;

  // Residuals above the noise model: inflates the covariance by (residual / noise)^2.
  static Matrix12 solved_covariance(const Solution& solution, const FeatureSweep& sweep) {
    const double off = solution.residual_m / std::max(1e-3, sweep.range_noise_m);
    return std::max(1.0, off * off) * solution.covariance;
  }

  // In a degenerate direction the pose is as certain as the window that was built from it, so the
  // sigma of the end is bounded there: otherwise the little that the data say would drag it back.
  Matrix12 state_covariance_of(const Solution& solution, const Degeneracy& weak,
                               const FeatureSweep& sweep) const {
    const Vector6 bound = sigmas(config.pose_sigma_m, config.pose_sigma_rad).array().square();
    const Matrix12 middle =
        with_bounded_pose_at(solution.seen_at, solution.state.twist,
                             solved_covariance(solution, sweep), bound.asDiagonal());
    Matrix12 covariance = end_covariance(solution.state, middle);
    Vector12 direction = Vector12::Zero();
    direction.head<3>() = weak.weak_translation;
    covariance = with_bounded(covariance, direction, config.begin_sigma_m);
    direction << Eigen::Vector3d::Zero(), weak.weak_rotation, Vector6::Zero();
    covariance = with_bounded(covariance, direction, config.begin_sigma_rad);
    return with_twist_scaled(covariance, 1e9 / std::max(1U, sweep.period_ns));
  }

  void found(PointSpan planes, const Pose& T_odom, std::uint32_t period_ns) {
    recent.clear();
    fits = {};
    forget_founding_sweep();
    recent.add(planes, T_odom);
    if (!twist_known) {
      founding_planes.assign(planes.begin(), planes.end());
      founding_period_ns = period_ns;
      founding_pose = T_odom;
    }
  }

  bool is_piece(const FeatureSweep& sweep) const {
    return !started && !passed_piece && !covers_turn(sweep);
  }

  Health judge(const FeatureSweep& sweep, const Solution& solution, bool founding,
               bool is_degenerate) const {
    if (!any_usable(sweep.less_sharp) && !any_usable(sweep.less_flat)) return Health::kEmpty;
    if (is_piece(sweep)) return Health::kPredicted;
    if (founding) return Health::kOk;
    if (solution.astray) return Health::kLost;
    if (!solution.solved) return Health::kPredicted;
    return is_degenerate ? Health::kDegenerate : Health::kOk;
  }

  bool founding_pending() const { return !founding_planes.empty(); }

  // Replaces the target by the initial sweep, deskewed by a twist.
  void deskew_founding_sweep(const Vector6& known_twist_per_s) {
    const DeskewTable table(known_twist_per_s, founding_period_ns, founding_period_ns);
    recent.clear();
    recent.add(deskewed(founding_planes, table), founding_pose);
  }

  void forget_founding_sweep() { founding_planes.clear(); }

  // The motion of the first sweep is only known from the second one. With both taken as rigid,
  // their middles are one step apart. From that step on, the second sweep's motion and the
  // deskewing of the first one are estimated alternately. In foliage the alternation may diverge:
  // the round of lowest cost is kept.
  Solution solve_second(const FeatureSweep& sweep, const Source& source,
                        const Prediction& predicted) {
    constexpr int kRounds = 4;
    const double period_s = sweep.period_ns * 1e-9;
    const double step_s = std::max(period_s, (sweep.stamp_ns - prev_instant_ns) * 1e-9 + period_s);
    Solution solution = match_rigidly(sweep, source, predicted);
    MotionPrior prior = predicted.prior;
    prior.twist =
        log_se3(founding_pose.inverse() * solution.state.T_odom_mid) * (period_s / step_s);
    prior.twist_sigma = moving_twist_sigma(*this, config, period_s, period_s);
    prior.information = independent(prior.begin_sigma, prior.twist_sigma);
    solution.state.twist = prior.twist;
    std::optional<Solution> best;
    for (int round = 0; round < kRounds && solution.solved; ++round) {
      const Vector6 twist = solution.state.twist;
      deskew_founding_sweep(twist / period_s);
      prior.T_odom_begin = founding_pose * exp_se3((step_s / period_s - 1.0) * twist);
      solution = match(sweep, source, {prior.T_odom_begin * exp_se3(0.5 * twist), twist}, prior);
      if (solution.solved && (!best || solution.cost < best->cost)) best = solution;
    }
    // The final target depends only on the published twist, so that restore() builds the same one.
    deskew_founding_sweep(best ? Vector6(best->state.twist / period_s) : Vector6(Vector6::Zero()));
    if (!best) return solution;
    forget_founding_sweep();
    return *best;
  }

  // Matches as if each sweep had been measured at one instant, its middle.
  Solution match_rigidly(const FeatureSweep& sweep, const Source& source,
                         const Prediction& predicted) {
    Source rigid = source;
    for (SourcePoint& p : rigid.planes) p.bin = kTimeBins / 2;
    MotionPrior wide = predicted.prior;
    wide.begin_sigma = wide.twist_sigma;
    wide.information = independent(wide.begin_sigma, wide.twist_sigma);
    return match_at_any_speed(rigid, predicted.state, wide, sweep.period_ns * 1e-9,
                              sweep.range_noise_m, config, recent);
  }

  Solution match(const FeatureSweep& sweep, const Source& source, const MotionState& initial,
                 const MotionPrior& prior) {
    return match_sweep(source, initial, prior, sweep.range_noise_m, config, recent);
  }

  Solution solve(const FeatureSweep& sweep, const Source& source, const Prediction& predicted) {
    recent.set_range_noise(sweep.range_noise_m);
    recent.set_use_rough(!inertial.felt());
    if (founding_pending() && sweep.period_ns > 0 && !sweep.deskewed) {
      return solve_second(sweep, source, predicted);
    }
    Solution best = match(sweep, source, predicted.state, predicted.prior);
    for (const MotionState& start : other_starts(sweep, source, predicted, best)) {
      const Solution other = match(sweep, source, start, predicted.prior);
      if (other.solved && (!best.solved || other.cost < best.cost)) best = other;
    }
    best.astray = is_astray(best);
    return best;
  }

  // Other starts of the matching, likeliest first: more of them if the result is doubtful.
  std::vector<MotionState> other_starts(const FeatureSweep& sweep, const Source& source,
                                        const Prediction& predicted, const Solution& found) {
    std::vector<MotionState> starts = predicted.starts;
    if (is_surprising(found) || !found.converged || fits_worse(found, kWorse)) {
      starts = turned_starts(*this, {sweep.stamp_ns, sweep.period_ns}, config, predicted.state);
    }
    return likeliest(source, starts, kTried, predicted.prior, sweep.range_noise_m, config, recent);
  }

  bool fits_worse(const Solution& solution, double factor) const {
    return solution.solved && fits.usual() && solution.fit > factor * *fits.usual();
  }

  // Whether the match is at a wrong pose: it has not converged and fits worse than the sweeps
  // before, or it fits far worse than these.
  bool is_astray(const Solution& solution) const {
    return (!solution.converged && fits_worse(solution, kWorse)) || fits_worse(solution, kFarWorse);
  }

  // Whether the solution is farther from the prior than one in a thousand is by chance (chi-squared
  // with eighteen degrees of freedom).
  static bool is_surprising(const Solution& solution) {
    constexpr double kSurprising = 42.3;
    return !solution.solved || 2.0 * solution.prior_cost > kSurprising;
  }

  /// Solves with the IMU's prediction, unless the points contradict it.
  Solution solve_as_foreseen(const FeatureSweep& sweep, Prediction& predicted);
  /// The match; the prediction if there is no target or the match is wrong, and rest at the last
  /// pose if the match rotates faster than any platform.
  Solution solve_within_bounds(const FeatureSweep& sweep, const Prediction& predicted);
  void commit(const OdometryResult& result, std::uint32_t period_ns);
  void note_acceleration(const OdometryResult& result, bool measured);

  Pose founding_pose = Pose::Identity();
};

Odometry::Odometry(const OdometryConfig& config, const Pose& T_base_lidar, const Pose& T_base_imu)
    : state_(std::make_unique<State>(config, T_base_lidar, T_base_imu)) {}
Odometry::~Odometry() = default;
Odometry::Odometry(Odometry&&) noexcept = default;
Odometry& Odometry::operator=(Odometry&&) noexcept = default;

// Updates the state by a result, be it an own one or one of another instance.
void Odometry::State::commit(const OdometryResult& result, std::uint32_t period_ns) {
  const bool has_points = !result.planes.empty();
  const bool solved = is_matched(result.health);
  note_acceleration(result, solved && twist_known && predicted_in_row == 0);
  predicted_in_row = solved ? 0 : predicted_in_row + 1;
  if (recent.empty() || (has_points && predicted_in_row >= config.restart_after)) {
    if (has_points) {
      found(result.planes, result.T_odom_base, period_ns);
      predicted_in_row = 0;
    }
  } else if (solved) {
    twist_known = true;
    recent.add(result.planes, result.T_odom_base);
  }
  started = true;
  prev_sweep = result.sweep;
  prev_instant_ns = result.instant_ns;
  prev_period_s = std::max(1e-9, period_ns * 1e-9);
  T_odom_base = result.T_odom_base;
  twist_change_per_s = result.twist_per_s - twist_per_s;
  twist_per_s = result.twist_per_s;
  state_covariance = result.state_covariance;
  inertial.take(result.inertia);
  if (result.fit > 0.0) fits.add(result.fit);
}

void Odometry::State::note_acceleration(const OdometryResult& result, bool measured) {
  const double between_s = (result.instant_ns - prev_instant_ns) * 1e-9;
  std::optional<Acceleration> change;
  if (measured && started && between_s > 0.0 && state_covariance && result.state_covariance) {
    const Matrix6 errors = (*state_covariance + *result.state_covariance).bottomRightCorner<6, 6>();
    const Vector6 a = (result.twist_per_s - twist_per_s) / between_s;
    change = Acceleration{a, unexplained(a, errors / (between_s * between_s))};
  }
  accelerations.push_back(change);
  if (accelerations.size() > kAccelerations) accelerations.pop_front();
}

OdometryResult Odometry::process(const FeatureSweep& sweep) {
  OdometryResult result = locate(sweep);
  complete(sweep, result);
  return result;
}

Solution Odometry::State::solve_within_bounds(const FeatureSweep& sweep,
                                              const Prediction& predicted) {
  Solution solution;
  solution.state = predicted.state;
  if (!recent.empty()) {
    solution = solve(sweep, choose_source(sweep, T_base_lidar, config), predicted);
  }
  const double turn_rad = solution.state.twist.tail<3>().norm();
  // From rest to the prediction, where rest is taken instead: it may be as wrong as that.
  Vector12 off = Vector12::Zero();
  if (sweep.period_ns > 0 && turn_rad > config.max_turn_radps * 1e-9 * sweep.period_ns) {
    solution = {};
    solution.state.T_odom_mid = T_odom_base;
    off << log_se3(T_odom_base.inverse() * predicted.state.T_odom_mid), predicted.state.twist;
  }
  if (solution.astray) {
    solution = {};
    solution.state = predicted.state;
    solution.astray = true;
  }
  NormalEquations prior_only;
  if (!solution.solved) {
    add_prior(solution.state, predicted.prior, prior_only);
    solution.covariance = prior_only.H.inverse();
    if (!off.isZero(0.0)) solution.covariance += off * off.transpose();
  }
  return solution;
}

Solution Odometry::State::solve_as_foreseen(const FeatureSweep& sweep, Prediction& predicted) {
  // Maximum ratio of the costs for the match without the IMU to be better by more than chance.
  constexpr double kBetterFit = 0.9;
  Solution solution = solve_within_bounds(sweep, predicted);
  const bool contradicted =
      solution.solved && inertial.contradicts(solution.state, solution.covariance);
  // A prediction that is wrong enough leaves no match at all.
  const bool unmatched = !solution.solved && inertial.foreseen();
  if (contradicted && inertial.on_probation()) {
    inertial.give_way();
  } else if (contradicted || unmatched || inertial.misleads(solution.fit)) {
    const Prediction alone = predict(*this, {sweep.stamp_ns, sweep.period_ns}, config);
    const Solution other = solve_within_bounds(sweep, alone);
    const bool better =
        unmatched ? !fits_worse(other, kWorse) : other.fit < kBetterFit * solution.fit;
    if (contradicted || (other.solved && better)) {
      inertial.give_way();
      predicted = alone;
      solution = other;
    }
  }
  if (solution.solved) inertial.note_fit(solution.fit);
  return solution;
}

OdometryResult Odometry::locate(const FeatureSweep& given) {
  const FeatureSweep sweep = with_period(given);
  State& s = *state_;
  if (sweep.slices > 1) {
    if (!s.knots) s.knots.emplace(s.config, s.T_base_lidar, s.T_base_imu);
    OdometryResult result = s.knots->process(sweep);
    result.slice_state = s.knots->state();
    return result;
  }
  const double period_s = std::max(1e-9, sweep.period_ns * 1e-9);
  OdometryResult result;
  result.sweep = sweep.sweep;
  result.prev_sweep = s.started ? s.prev_sweep : sweep.sweep;
  result.instant_ns = sweep.stamp_ns + sweep.period_ns;

  s.inertial.feel(s.config.use_imu && !sweep.deskewed ? sweep.imu : ImuSpan{}, sweep.stamp_ns,
                  sweep.period_ns);
  Prediction predicted = foresee(s, {sweep.stamp_ns, sweep.period_ns}, s.config, s.inertial);
  const bool founding = s.recent.empty();
  Solution solution = s.solve_as_foreseen(sweep, predicted);
  if (solution.solved && s.inertial.rests(solution.state, solution.covariance, s.config)) {
    hold_still(period_s * sigmas(kRestSpeed_mps, kRestRate_radps), solution.state,
               solution.covariance);
  }
  result.T_odom_base = s.started ? solution.state.T_odom_end() : Pose::Identity();
  result.twist_per_s = solution.state.twist / period_s;
  if (solution.solved && solution.converged) result.fit = solution.fit;
  if (solution.solved || s.inertial.foreseen()) result.bend = solution.state.bend;
  const Matrix12 covariance = end_covariance(solution.state, solution.covariance);
  result.covariance = s.config.covariance_scale * covariance.topLeftCorner<6, 6>();
  result.degeneracy = find_weak_directions(solution.data, predicted.prior, s.config);
  if (solution.solved) {
    result.state_covariance = s.state_covariance_of(solution, result.degeneracy, sweep);
  } else if (s.inertial.foreseen()) {
    result.state_covariance = with_twist_scaled(covariance, 1.0 / period_s);
  }
  result.inertial_step = s.inertial.step();
  const Matrix12 unknowns = State::solved_covariance(solution, sweep);
  result.inertia = s.inertial.learned(solution.state, unknowns, result.state_covariance, s.config);
  if (s.inertial.foreseen() && solution.solved) {
    // With the bounded pose the twist would seem known, and gravity alone would have to explain
    // later differences: the twist keeps its unbounded covariance.
    result.state_covariance =
        with_twist_of(*result.state_covariance,
                      with_twist_scaled(end_covariance(solution.state, unknowns), 1.0 / period_s));
  }

  const Pose error = predicted.state.T_odom_end().inverse() * result.T_odom_base;
  result.diagnostics = {solution.iterations,
                        solution.planes,
                        solution.residual_m,
                        error.translation().norm(),
                        log_so3(error.linear()).norm(),
                        s.inertial.foreseen(),
                        result.inertia ? result.inertia->contradictions : 0,
                        s.inertial.felt() || sweep.deskewed};
  result.health = s.judge(sweep, solution, founding, result.degeneracy.degenerate);
  if (founding && result.health != Health::kEmpty) result.degeneracy = {};
  return result;
}

void Odometry::complete(const FeatureSweep& given, OdometryResult& result) {
  const FeatureSweep sweep = with_period(given);
  State& s = *state_;
  if (sweep.slices > 1) return;
  // Nothing is known before the first points: restore() passes over such sweeps too.
  if (!s.started && result.health == Health::kEmpty) return;
  if (s.is_piece(sweep)) {
    s.passed_piece = true;
    return;
  }
  const Vector6 twist_per_s = sweep.deskewed ? Vector6(Vector6::Zero()) : result.twist_per_s;
  const Vector6 bend = sweep.deskewed ? Vector6(Vector6::Zero()) : result.bend;
  const DeskewTable table = DeskewTable(twist_per_s, sweep.period_ns, sweep.period_ns).bent(bend);
  const std::vector<MotionLanes> motions = table.lanes(s.T_base_lidar);
  result.edges = moved_by(motions, table, sweep.less_sharp);
  result.planes = moved_by(motions, table, sweep.less_flat);
  if (sweep.deskewed) {
    for (PointVector* points : {&result.edges, &result.planes}) {
      for (Point& p : *points) p.time_ns = sweep.period_ns;
    }
  }
  s.commit(result, sweep.period_ns);
}

void Odometry::restore(std::span<const CommittedSweep> sweeps) {
  reset();
  // Unmatched sweeps enter no target: the one of those at the beginning is made of sweeps older
  // than these.
  bool known = std::none_of(sweeps.begin(), sweeps.end(), is_a_match);
  for (const CommittedSweep& sweep : sweeps) {
    known = known || is_a_match(sweep);
    const bool first = sweep.prev_sweep == sweep.sweep;
    if (first && state_->started) reset();
    if (!state_->started && first && sweep.health == Health::kEmpty) continue;
    if (!state_->started && first && sweep.health == Health::kPredicted) {
      state_->passed_piece = true;
      continue;
    }
    // A first sweep was published before its twist was known.
    if (!state_->started) state_->twist_known = !first;
    if (state_->founding_pending() && is_matched(sweep.health)) {
      state_->deskew_founding_sweep(sweep.twist_per_s);
      state_->forget_founding_sweep();
    }
    OdometryResult result = result_of(sweep);
    if (!known) result.planes.clear();
    state_->commit(result, std::max(sweep.period_ns, kLeastPeriod_ns));
  }
}

bool Odometry::restore_slices(std::span<const std::uint64_t> state, const SliceAt& slice_at) {
  reset();
  State& s = *state_;
  s.knots.emplace(s.config, s.T_base_lidar, s.T_base_imu);
  return s.knots->restore(state, [&](std::uint64_t number) {
    std::optional<FeatureSweep> slice = slice_at(number);
    if (slice) slice = with_period(*slice);
    return slice;
  });
}

void Odometry::configure(const OdometryConfig& config) {
  state_->config = config;
  if (state_->knots) state_->knots->configure(config);
}

void Odometry::reset() {
  state_ = std::make_unique<State>(state_->config, state_->T_base_lidar, state_->T_base_imu);
}

std::size_t Odometry::restore_depth() const {
  const auto window = static_cast<std::size_t>(std::max(1, state_->config.window_sweeps));
  return std::max(window, kAccelerations) + 1;
}

}  // namespace zloam::odometry
