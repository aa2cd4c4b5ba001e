#include "odometry/knot_odometry.hpp"

#include <algorithm>
#include <cmath>

#include "common/containers/thinning.hpp"
#include "common/geometry/state_bits.hpp"
#include "odometry/matcher.hpp"
#include "odometry/motion_prediction.hpp"

namespace zloam::odometry {
namespace {

// A longer gap is not bridged: the motion during it is unknown.
constexpr std::int64_t kMostGap_ns = 500'000'000;
// Relative to the usual share of points on surfaces: below kLost the pose is lost. Around a corner,
// where much is new, the share falls to 0.6; a sensor that was carried away has less. Shares below
// kStillUsual do not count for the usual one.
constexpr double kLost = 0.5;
constexpr double kStillUsual = 0.8;
// Maximum share of a revolution's solutions that do not converge. Around corners it is rarely more
// than half of them, with a lost heading nearly all.
constexpr double kMostRestless = 0.6;
// Below this mean rate in the first revolution the platform is at rest: the gyroscope shows its
// bias.
constexpr double kRestRate_radps = 0.02;
// An estimate this close to the Earth's mean gravity is plausible: the accelerometer has errors.
constexpr double kGravity_mps2 = 9.81;
constexpr double kGravityOff_mps2 = 1.0;
// Ratio of the residuals with the IMU to those without it, in one revolution. A correct IMU has 0.5
// to 0.8 while the platform moves and 1.0 at rest; one that is mounted wrongly, or reads degrees,
// has 1.1 to 2.
constexpr double kMisled = 1.15;
// Above this ratio one revolution is proof: during a second one the target would be distorted.
constexpr double kCertain = 1.5;
// Minimum explained share of points for the solution without the IMU to count.
constexpr double kExplained = 0.5;
// Number of such revolutions until the IMU is ignored: a single one may be chance.
constexpr std::uint32_t kDoubted = 2;
// Version of the layout of state(): change it when the contents change.
constexpr std::uint64_t kLayout = 3;

/// When a slice's points were measured.
struct Times {
  std::int64_t begin_ns, end_ns, stamp_ns;
};

/// The points of a slice in base_link at a pose; the motion between two knots is a constant twist.
PointVector placed(const Times& times, const Pose& T_odom_begin, const Pose& T_odom_end,
                   const Pose& T_base_lidar, PointSpan points, const Pose& T_odom_to) {
  constexpr std::size_t kSteps = 64;
  const Vector6 twist = log_se3(T_odom_begin.inverse() * T_odom_end);
  const std::vector<Pose> along = exp_se3_along(twist, 0.0, 1.0 / kSteps, kSteps + 1);
  const Pose T_to_begin = T_odom_to.inverse() * T_odom_begin;
  const auto span_ns =
      static_cast<double>(std::max<std::int64_t>(1, times.end_ns - times.begin_ns));
  PointVector out;
  out.reserve(points.size());
  for (const Point& p : points) {
    if (!is_usable(p)) continue;
    const double part = static_cast<double>(times.stamp_ns + p.time_ns - times.begin_ns) / span_ns;
    const auto step = static_cast<std::size_t>(std::lround(std::clamp(part, 0.0, 1.0) * kSteps));
    const Eigen::Vector3f q =
        (T_to_begin * (along[step] * (T_base_lidar * p.position().cast<double>()))).cast<float>();
    out.push_back({q.x(), q.y(), q.z(), p.intensity, p.time_ns, p.ring, p.return_type, p.reserved});
  }
  return out;
}

std::int64_t end_of(const FeatureSweep& sweep) { return sweep.stamp_ns + sweep.period_ns; }

}  // namespace

KnotOdometry::KnotOdometry(const OdometryConfig& config, const Pose& T_base_lidar,
                           const Pose& T_base_imu)
    : config_(config), T_base_lidar_(T_base_lidar), T_base_imu_(T_base_imu), window_(config) {}

void KnotOdometry::configure(const OdometryConfig& config) {
  config_ = config;
  window_.configure(config);
}

void KnotOdometry::reset() { *this = KnotOdometry(config_, T_base_lidar_, T_base_imu_); }

void KnotOdometry::begin(const FeatureSweep& sweep, const Pose& T_odom_base) {
  turn_ = std::max<std::size_t>(2, sweep.slices);
  range_noise_m_ = sweep.range_noise_m;
  make_target();
  window_.begin(T_odom_base);
  window_.inertia() = {};
  kept_.clear();
  explained_ = {};
  restless_ = 0.0;
  seen_ = 0;
  bad_in_row_ = 0;
  end_ns_ = sweep.stamp_ns;
  begun_ = true;
}

std::size_t KnotOdometry::most_settled() const {
  return turn_ * static_cast<std::size_t>(std::max(1, config_.window_sweeps));
}

void KnotOdometry::make_target() {
  OdometryConfig of_target = config_;
  of_target.window_sweeps = static_cast<int>(most_settled());
  recent_.emplace(of_target, range_noise_m_);
  settled_.clear();
}

Slice KnotOdometry::slice_of(const FeatureSweep& sweep, const MadeWith& with) const {
  Slice slice;
  const auto period_ns = std::max<std::int64_t>(1, end_of(sweep) - with.begin_ns);
  slice.period_s = 1e-9 * static_cast<double>(period_ns);
  const std::size_t wanted =
      std::max<std::size_t>(1, static_cast<std::size_t>(config_.max_matched_points) / (2 * turn_));
  const Thinning thinning{std::max<std::size_t>(1, (sweep.less_flat.size() + wanted - 1) / wanted),
                          sweep.sweep};
  thinning.each(sweep.less_flat, [&](const Point& p) {
    if (!is_usable(p)) return;
    const std::int64_t since_ns = sweep.stamp_ns + p.time_ns - with.begin_ns;
    const double part = static_cast<double>(since_ns) / static_cast<double>(period_ns);
    slice.points.push_back(
        {T_base_lidar_ * p.position().cast<double>(), std::clamp(part, 0.0, 1.0)});
  });
  if (config_.use_imu && with.with_inertia && !sweep.imu.empty()) {
    slice.rate_bias_radps = with.rate_bias_radps;
    ImuErrors errors;
    errors.rate_radps = slice.rate_bias_radps;
    slice.inertia = integrate(sweep.imu, with.begin_ns, static_cast<std::uint32_t>(period_ns),
                              T_base_imu_, errors);
  }
  return slice;
}

void KnotOdometry::keep(const FeatureSweep& sweep, std::int64_t begin_ns) {
  kept_.push_back({sweep.sweep,
                   begin_ns,
                   end_of(sweep),
                   sweep.stamp_ns,
                   {sweep.less_sharp.begin(), sweep.less_sharp.end()},
                   {sweep.less_flat.begin(), sweep.less_flat.end()}});
}

void KnotOdometry::settle(std::size_t k) {
  const Kept& kept = kept_[k];
  const Pose& begin = window_.knots()[k];
  const Pose& end = window_.knots()[k + 1];
  recent_->add(placed({kept.begin_ns, kept.end_ns, kept.stamp_ns}, begin, end, T_base_lidar_,
                      kept.planes, end),
               end);
  settled_.push_back({kept.sweep, kept.begin_ns, begin, end});
  if (settled_.size() > most_settled()) settled_.pop_front();
}

/// Makes the first revolution the target, with its motion as far as it is known by now.
void KnotOdometry::found() {
  recent_->clear();
  settled_.clear();
  for (std::size_t k = 0; k < turn_; ++k) settle(k);
}

/// Estimates the gyroscope's bias if the platform is at rest in the first revolution.
void KnotOdometry::note_rest() {
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();
  double time_s = 0.0;
  for (const Slice& slice : window_.slices()) {
    if (!slice.inertia) continue;
    turn += slice.inertia->turn_rad;
    time_s += slice.period_s;
  }
  if (time_s == 0.0) return;
  const Eigen::Vector3d rate_radps = turn / time_s;
  if (rate_radps.norm() < kRestRate_radps) window_.inertia().rate_bias_radps = rate_radps;
}

/// Estimates gravity from the slices with readings: the mean acceleration minus the mean specific
/// force. Readings may begin later than the slices.
void KnotOdometry::find_gravity() {
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  double time_s = 0.0;
  std::size_t with = 0;
  const auto velocity_mps = [&](std::size_t k) -> Eigen::Vector3d {
    return window_.knots()[k].linear() * window_.velocity(k).head<3>();
  };
  Eigen::Vector3d first = Eigen::Vector3d::Zero(), last = first;
  for (std::size_t k = 0; k < window_.slices().size(); ++k) {
    const Slice& slice = window_.slices()[k];
    if (!slice.inertia) continue;
    force += slice.period_s * (window_.knots()[k].linear() * slice.inertia->mean_force_mps2);
    time_s += slice.period_s;
    last = velocity_mps(k);
    if (with++ == 0) first = last;
  }
  if (2 * with < turn_) return;
  const Eigen::Vector3d gravity_mps2 = (last - first - force) / time_s;
  if (std::abs(gravity_mps2.norm() - kGravity_mps2) < kGravityOff_mps2) {
    window_.inertia().gravity_mps2 = gravity_mps2;
  } else {
    imu_contradictions_ = kDoubted;
  }
}

bool KnotOdometry::believes_inertia() const { return imu_contradictions_ < kDoubted; }

void KnotOdometry::judge_inertia(const KnotSolution& solution, double range_noise_m) {
  if (!ends_turn() || !settled() || !solution.solved || !believes_inertia()) return;
  if (!window_.slices().back().inertia) return;
  KnotWindow alone = window_.without_inertia();
  const KnotSolution second = alone.solve(*recent_, range_noise_m);
  if (!second.solved || second.explained < kExplained ||
      solution.residual_m < kMisled * second.residual_m) {
    return;
  }
  imu_contradictions_ += solution.residual_m > kCertain * second.residual_m ? kDoubted : 1;
  if (!believes_inertia()) window_ = std::move(alone);
}

/// Moves the oldest slices from the window into the target.
void KnotOdometry::let_settle() {
  while (window_.slices().size() > 2 * turn_) {
    if (seen_ > 3 * turn_) settle(0);
    window_.pop();
    kept_.pop_front();
  }
}

void KnotOdometry::fill_clouds(OdometryResult& result) const {
  if (!ends_turn()) return;
  for (std::size_t k = 0; k < turn_; ++k) {
    const Kept& kept = kept_[k];
    for (auto [from, to] :
         {std::pair{&kept.edges, &result.edges}, std::pair{&kept.planes, &result.planes}}) {
      const PointVector points =
          placed({kept.begin_ns, kept.end_ns, kept.stamp_ns}, window_.knots()[k],
                 window_.knots()[k + 1], T_base_lidar_, *from, result.T_odom_base);
      to->insert(to->end(), points.begin(), points.end());
    }
  }
  const auto at_end = static_cast<std::uint32_t>(kept_.back().end_ns - kept_.back().stamp_ns);
  for (PointVector* points : {&result.edges, &result.planes}) {
    for (Point& p : *points) p.time_ns = at_end;
  }
}

Health KnotOdometry::judge(const FeatureSweep& sweep, const KnotSolution& solution) {
  if (!settled()) return Health::kOk;
  const double usual = explained_.usual().value_or(0.0);
  const double restless = solution.converged ? 0.0 : 1.0;
  restless_ += (restless - restless_) / static_cast<double>(turn_);
  const bool lost = solution.explained < kLost * usual || restless_ > kMostRestless;
  const bool bad = !solution.solved || lost;
  bad_in_row_ = bad ? bad_in_row_ + 1 : 0;
  if (solution.explained > kStillUsual * usual) explained_.add(solution.explained);
  if (!any_usable(sweep.less_flat)) return Health::kEmpty;
  if (lost) return Health::kLost;
  return bad ? Health::kPredicted : Health::kOk;
}

/// Degenerate directions of the window taken as rigid: what two revolutions do not constrain, no
/// single slice does.
Degeneracy KnotOdometry::weak_directions(const KnotSolution& solution) const {
  MotionPrior prior;
  prior.begin_sigma = sigmas(config_.begin_sigma_m, config_.begin_sigma_rad);
  const double period_s = window_.slices().back().period_s;
  prior.twist_sigma = period_s * period_s *
                      sigmas(config_.slice_acceleration_sigma_mps2,
                             config_.slice_angular_acceleration_sigma_radps2);
  return find_weak_directions(solution.data, prior, config_);
}

bool KnotOdometry::must_restart(const FeatureSweep& sweep) const {
  const std::int64_t gap_ns = sweep.stamp_ns - end_ns_;
  const bool torn = gap_ns > kMostGap_ns || end_of(sweep) <= end_ns_;
  const bool hopeless = bad_in_row_ >= config_.restart_after * static_cast<int>(turn_);
  return !begun_ || torn || hopeless;
}

void KnotOdometry::take(const FeatureSweep& sweep) {
  Slice slice = slice_of(
      sweep, {sweep.sweep, end_ns_, window_.inertia().rate_bias_radps, believes_inertia()});
  if (seen_ < turn_) slice.points.clear();
  keep(sweep, end_ns_);
  window_.push(std::move(slice));
  ++seen_;
  end_ns_ = end_of(sweep);
  prev_sweep_ = sweep.sweep;
}

void KnotOdometry::learn_inertia() {
  if (seen_ > 2 * turn_) {
    const double root_s = std::sqrt(window_.slices().back().period_s);
    window_.inertia().gravity_sigma_mps2 = config_.imu_gravity_walk * root_s;
    window_.inertia().rate_bias_sigma_radps = config_.imu_rate_walk * root_s;
  }
  if (seen_ == turn_) note_rest();
  // Later only with motion that was estimated from all slices of the window.
  const bool asks_gravity = seen_ == turn_ || (ends_turn() && seen_ >= 3 * turn_);
  if (asks_gravity && believes_inertia() && !window_.knows_gravity()) find_gravity();
}

KnotSolution KnotOdometry::solve(double range_noise_m) {
  if (seen_ >= turn_ && seen_ <= 2 * turn_) found();
  let_settle();
  KnotSolution solution;
  if (settled()) solution = window_.solve(*recent_, range_noise_m);
  judge_inertia(solution, range_noise_m);
  return solution;
}

OdometryDiagnostics KnotOdometry::diagnostics(const KnotSolution& solution,
                                              const Pose& T_odom_predicted) const {
  const Pose error = T_odom_predicted.inverse() * window_.knots().back();
  OdometryDiagnostics found;
  found.iterations = solution.iterations;
  found.planes = solution.matched;
  found.residual_m = solution.residual_m;
  found.prediction_error_m = error.translation().norm();
  found.prediction_error_rad = log_so3(error.linear()).norm();
  found.imu_used = window_.slices().back().inertia.has_value();
  found.imu_contradictions = imu_contradictions_;
  found.imu_covers = found.imu_used;
  return found;
}

OdometryResult KnotOdometry::process(const FeatureSweep& sweep) {
  OdometryResult result;
  if (must_restart(sweep)) {
    result.new_frame = begun_;
    begin(sweep, begun_ ? window_.knots().back() : Pose::Identity());
  }
  result.sweep = sweep.sweep;
  result.prev_sweep = seen_ == 0 ? sweep.sweep : prev_sweep_;
  take(sweep);
  result.instant_ns = end_ns_;
  const Pose T_odom_predicted = window_.knots().back();
  learn_inertia();
  const KnotSolution solution = solve(sweep.range_noise_m);

  if (solution.solved) result.degeneracy = weak_directions(solution);
  result.health = judge(sweep, solution);
  if (result.health == Health::kOk && result.degeneracy.degenerate) {
    result.health = Health::kDegenerate;
  }
  result.T_odom_base = window_.knots().back();
  result.twist_per_s = window_.velocity(window_.slices().size() - 1);
  result.covariance = config_.covariance_scale * solution.covariance;
  result.diagnostics = diagnostics(solution, T_odom_predicted);
  fill_clouds(result);
  return result;
}

template <class Bits>
void KnotOdometry::each(Bits& bits, std::deque<MadeWith>& made_with) {
  bits(turn_, seen_, end_ns_, prev_sweep_, bad_in_row_, imu_contradictions_, range_noise_m_,
       explained_, restless_, settled_, made_with);
  window_.each(bits);
}

std::vector<std::uint64_t> KnotOdometry::state() {
  // Before this, some slices of the window have not been matched.
  if (!ends_turn() || seen_ < 3 * turn_) return {};
  StateBits bits;
  std::uint64_t layout = kLayout;
  std::deque<MadeWith> made_with;
  for (std::size_t k = 0; k < kept_.size(); ++k) {
    const Slice& slice = window_.slices()[k];
    made_with.push_back(
        {kept_[k].sweep, kept_[k].begin_ns, slice.rate_bias_radps, slice.inertia.has_value()});
  }
  bits(layout);
  each(bits, made_with);
  return bits.take();
}

bool KnotOdometry::restore(std::span<const std::uint64_t> state, const SliceAt& slice_at) {
  reset();
  if (take_back(state, slice_at)) return true;
  reset();
  return false;
}

bool KnotOdometry::take_back(std::span<const std::uint64_t> state, const SliceAt& slice_at) {
  StateBits bits(state);
  std::uint64_t layout = 0;
  bits(layout);
  if (layout != kLayout) return false;
  std::deque<MadeWith> made_with;
  each(bits, made_with);
  begun_ = bits.complete() && is_sound(made_with);
  return begun_ && settle_again(slice_at) && hold_again(made_with, slice_at);
}

bool KnotOdometry::is_sound(const std::deque<MadeWith>& made_with) const {
  // At poses farther away no point can be matched.
  constexpr double kFarthest_m = 1e6;
  const auto sound = [](const Pose& pose) {
    return pose.linear().isUnitary(1e-6) && pose.translation().norm() < kFarthest_m;
  };
  const auto places = [&](const Settled& s) {
    return sound(s.T_odom_begin) && sound(s.T_odom_end);
  };
  return turn_ >= 2 && made_with.size() == 2 * turn_ && settled_.size() <= most_settled() &&
         window_.knots().size() == made_with.size() + 1 && range_noise_m_ >= 0.0 &&
         range_noise_m_ < kFarthest_m && restless_ >= 0.0 && restless_ <= 1.0 &&
         std::all_of(settled_.begin(), settled_.end(), places) &&
         std::all_of(window_.knots().begin(), window_.knots().end(), sound);
}

bool KnotOdometry::settle_again(const SliceAt& slice_at) {
  const std::deque<Settled> settled = settled_;
  make_target();
  for (const Settled& of : settled) {
    const std::optional<FeatureSweep> sweep = slice_at(of.sweep);
    if (!sweep) continue;
    recent_->add(placed({of.begin_ns, end_of(*sweep), sweep->stamp_ns}, of.T_odom_begin,
                        of.T_odom_end, T_base_lidar_, sweep->less_flat, of.T_odom_end),
                 of.T_odom_end);
    settled_.push_back(of);
  }
  return settled_.size() >= turn_;
}

bool KnotOdometry::hold_again(const std::deque<MadeWith>& made_with, const SliceAt& slice_at) {
  std::deque<Slice> slices;
  for (const MadeWith& with : made_with) {
    const std::optional<FeatureSweep> sweep = slice_at(with.sweep);
    if (!sweep) return false;
    slices.push_back(slice_of(*sweep, with));
    keep(*sweep, with.begin_ns);
  }
  window_.hold(std::move(slices));
  return true;
}

}  // namespace zloam::odometry
