#include "aloam/core/scan_to_scan.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "aloam/core/clouds.hpp"
#include "aloam/core/cost_functions.hpp"
#include "aloam/core/ring_target.hpp"

namespace zloam::aloam {
namespace {

constexpr int kRounds = 2;
// The motion is not predicted over more missing sweeps than these.
constexpr double kMostPredicted = 10.0;

struct Target {
  RingTarget edges, planes;
  Pose T_odom_lidar;
  std::int64_t instant_ns;
};

std::int64_t instant_of(const ScanView& scan) {
  return scan.stamp_ns + ScanToScan::instant_ns(scan);
}

double periods_since(std::int64_t before_ns, const ScanView& scan) {
  return periods_between(before_ns, instant_of(scan), scan.period_ns);
}

// Fraction of a motion over so many periods, which ends in the middle of the sweep, at a point's
// time.
double share_of(const Point& p, const ScanView& scan, double periods) {
  const double time = std::clamp(static_cast<double>(p.time_ns) / scan.period_ns, 0.0, 1.0);
  return 1.0 + (time - 0.5) / periods;
}

}  // namespace

double periods_between(std::int64_t before_ns, std::int64_t instant_ns, std::uint32_t period_ns) {
  if (period_ns == 0) return 1.0;
  const double periods = static_cast<double>(instant_ns - before_ns) / period_ns;
  return std::max(1.0, std::round(periods));
}

struct ScanToScan::State {
  bool deskew = false;
  std::optional<Target> target;
  // Of the sweep before: nothing before the first one.
  std::optional<std::int64_t> instant_ns;
  Pose T_odom_lidar = Pose::Identity();
  Pose step = Pose::Identity();
  double periods = 1.0;

  bool in_motion(const ScanView& scan) const {
    return deskew && !scan.deskewed && scan.period_ns > 0;
  }
  Pose step_over(double wanted_periods) const;
  void match(const ScanView& scan, ScanMotion& result);
  void solve(const ScanView& scan, Motion& motion, ScanMotion& result) const;
  PointVector at_instant(PointSpan points, const ScanView& scan) const;
};

void ScanToScan::State::solve(const ScanView& scan, Motion& motion, ScanMotion& result) const {
  MotionProblem problem(motion);
  result.lines = result.surfaces = 0;
  const double since_target = periods_since(target->instant_ns, scan);
  const bool moves = in_motion(scan);
  for (const Point& p : scan.sharp) {
    const double share = moves ? share_of(p, scan, since_target) : 1.0;
    const Eigen::Vector3d point = position_of(p);
    const auto line = target->edges.line_near(motion.part(share) * point);
    if (!line) continue;
    problem.add(LineCost::create(point, (*line)[0], (*line)[1], share));
    ++result.lines;
  }
  for (const Point& p : scan.flat) {
    const double share = moves ? share_of(p, scan, since_target) : 1.0;
    const Eigen::Vector3d point = position_of(p);
    const auto plane = target->planes.plane_near(motion.part(share) * point);
    if (!plane) continue;
    problem.add(PlaneCost::create(point, (*plane)[0], (*plane)[1], (*plane)[2], share));
    ++result.surfaces;
  }
  if (problem.correspondences() < kFewestCorrespondences) return;
  const Solved solved = problem.solve();
  if (!solved.usable) return;
  result.iterations += solved.iterations;
  result.residual_m = solved.residual_m;
  result.matched = true;
}

Pose ScanToScan::State::step_over(double wanted_periods) const {
  const double predicted_periods = std::min(wanted_periods, kMostPredicted);
  // Without missing sweeps it is the last motion itself, as in A-LOAM.
  if (predicted_periods == periods) return step;
  return Motion::of(step).part(predicted_periods / periods).pose();
}

// The target is the last sweep that had points, normally the sweep before.
void ScanToScan::State::match(const ScanView& scan, ScanMotion& result) {
  if (!target) return;
  const double since = instant_ns ? periods_since(*instant_ns, scan) : 1.0;
  const Pose predicted = T_odom_lidar * step_over(since);
  periods = since;
  Motion motion = Motion::of(target->T_odom_lidar.inverse() * predicted);
  for (int round = 0; round < kRounds; ++round) solve(scan, motion, result);
  const Pose found = result.matched ? target->T_odom_lidar * motion.pose() : predicted;
  step = T_odom_lidar.inverse() * found;
  T_odom_lidar = normalised(found);
}

PointVector ScanToScan::State::at_instant(PointSpan points, const ScanView& scan) const {
  PointVector out(points.begin(), points.end());
  if (!in_motion(scan)) return out;
  const Motion motion = Motion::of(step);
  const Pose back = step.inverse();
  for (Point& p : out) p = moved(p, back * motion.part(share_of(p, scan, periods)).pose());
  return out;
}

ScanToScan::ScanToScan(bool deskew) : state_(new State) { state_->deskew = deskew; }
ScanToScan::~ScanToScan() = default;
ScanToScan::ScanToScan(ScanToScan&&) noexcept = default;
ScanToScan& ScanToScan::operator=(ScanToScan&&) noexcept = default;

ScanMotion ScanToScan::process(const ScanView& scan) {
  State& s = *state_;
  ScanMotion result;
  s.match(scan, result);
  s.instant_ns = result.instant_ns = instant_of(scan);
  result.T_odom_lidar = s.T_odom_lidar;
  result.step = s.step;
  result.periods = s.periods;
  result.edges = s.at_instant(scan.less_sharp, scan);
  result.planes = s.at_instant(scan.less_flat, scan);
  if (!result.edges.empty() || !result.planes.empty()) {
    s.target.emplace(Target{RingTarget(result.edges), RingTarget(result.planes), s.T_odom_lidar,
                            result.instant_ns});
  }
  return result;
}

std::uint32_t ScanToScan::instant_ns(const ScanView& scan) {
  return scan.deskewed ? scan.period_ns : scan.period_ns / 2;
}

void ScanToScan::restore(const ScanMotion& last) {
  State& s = *state_;
  s.instant_ns = last.instant_ns;
  s.T_odom_lidar = last.T_odom_lidar;
  s.step = last.step;
  s.periods = last.periods;
  s.target.emplace(
      Target{RingTarget(last.edges), RingTarget(last.planes), last.T_odom_lidar, last.instant_ns});
}

void ScanToScan::reset() {
  const bool deskew = state_->deskew;
  *state_ = State{};
  state_->deskew = deskew;
}

}  // namespace zloam::aloam
