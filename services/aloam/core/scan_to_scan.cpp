#include "aloam/core/scan_to_scan.hpp"

#include <algorithm>
#include <optional>

#include "aloam/core/clouds.hpp"
#include "aloam/core/cost_functions.hpp"
#include "aloam/core/ring_target.hpp"

namespace zloam::aloam {
namespace {

constexpr int kRounds = 2;
// A-LOAM only prints a warning below this; here a motion from fewer correspondences is rejected.
constexpr std::uint32_t kFewest = 10;

struct Target {
  RingTarget edges, planes;
  Pose T_odom_lidar;
};

// Fraction of the motion, counted from the middle of the sweep before, at a point's time.
double share_of(const Point& p, const ScanView& scan, bool deskew) {
  if (!deskew || scan.deskewed || scan.period_ns == 0) return 1.0;
  return 0.5 + std::clamp(static_cast<double>(p.time_ns) / scan.period_ns, 0.0, 1.0);
}

}  // namespace

struct ScanToScan::State {
  bool deskew = false;
  std::optional<Target> target;
  Pose T_odom_lidar = Pose::Identity();
  // motion of the sweep before
  Pose step = Pose::Identity();

  void match(const ScanView& scan, ScanMotion& result);
  void solve(const ScanView& scan, Motion& motion, ScanMotion& result) const;
  PointVector at_instant(PointSpan points, const ScanView& scan) const;
};

void ScanToScan::State::solve(const ScanView& scan, Motion& motion, ScanMotion& result) const {
  MotionProblem problem(motion);
  result.lines = result.surfaces = 0;
  for (const Point& p : scan.sharp) {
    const double share = share_of(p, scan, deskew);
    const Eigen::Vector3d point = position_of(p);
    const auto line = target->edges.line_near(motion.part(share) * point);
    if (!line) continue;
    problem.add(LineCost::create(point, (*line)[0], (*line)[1], share));
    ++result.lines;
  }
  for (const Point& p : scan.flat) {
    const double share = share_of(p, scan, deskew);
    const Eigen::Vector3d point = position_of(p);
    const auto plane = target->planes.plane_near(motion.part(share) * point);
    if (!plane) continue;
    problem.add(PlaneCost::create(point, (*plane)[0], (*plane)[1], (*plane)[2], share));
    ++result.surfaces;
  }
  if (problem.correspondences() < kFewest) return;
  const Solved solved = problem.solve();
  result.iterations += solved.iterations;
  result.residual_m = solved.residual_m;
  result.matched = true;
}

// The target is the last sweep that had points, normally the sweep before.
void ScanToScan::State::match(const ScanView& scan, ScanMotion& result) {
  if (!target) return;
  const Pose predicted = T_odom_lidar * step;
  Motion motion = Motion::of(target->T_odom_lidar.inverse() * predicted);
  for (int round = 0; round < kRounds; ++round) solve(scan, motion, result);
  const Pose found = result.matched ? target->T_odom_lidar * motion.pose() : predicted;
  step = T_odom_lidar.inverse() * found;
  T_odom_lidar = normalised(found);
}

PointVector ScanToScan::State::at_instant(PointSpan points, const ScanView& scan) const {
  PointVector out(points.begin(), points.end());
  if (!deskew || scan.deskewed) return out;
  const Motion motion = Motion::of(step);
  const Pose back = step.inverse();
  for (Point& p : out) p = moved(p, back * motion.part(share_of(p, scan, deskew)).pose());
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
  result.T_odom_lidar = s.T_odom_lidar;
  result.step = s.step;
  result.edges = s.at_instant(scan.less_sharp, scan);
  result.planes = s.at_instant(scan.less_flat, scan);
  if (!result.edges.empty() || !result.planes.empty()) {
    s.target.emplace(Target{RingTarget(result.edges), RingTarget(result.planes), s.T_odom_lidar});
  }
  return result;
}

std::uint32_t ScanToScan::instant_ns(const ScanView& scan) {
  return scan.deskewed ? scan.period_ns : scan.period_ns / 2;
}

void ScanToScan::restore(const Pose& T_odom_lidar, const Pose& step, PointSpan edges,
                         PointSpan planes) {
  state_->T_odom_lidar = T_odom_lidar;
  state_->step = step;
  state_->target.emplace(Target{RingTarget(edges), RingTarget(planes), T_odom_lidar});
}

void ScanToScan::reset() {
  const bool deskew = state_->deskew;
  *state_ = State{};
  state_->deskew = deskew;
}

}  // namespace zloam::aloam
