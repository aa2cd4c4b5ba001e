// Scan to scan against the motion with which the sweeps were simulated, and the cost functions
// against independently computed distances.

#include "aloam/core/scan_to_scan.hpp"

#include <gtest/gtest.h>

#include "aloam/core/cost_functions.hpp"
#include "aloam/core/motion_problem.hpp"
#include "aloam/core/ring_target.hpp"
#include "aloam/core/scan_registration.hpp"
#include "aloam/core/test_room.hpp"

namespace zloam::aloam {
namespace {

/// `number` of the sweep since the start.
ScanMotion feed(ScanToScan& odometry, const PointVector& sweep, int number) {
  const ScanFeatures f = extract_features(sweep, 0.3);
  const std::int64_t stamp_ns = std::int64_t{number} * test::kPeriod_ns;
  return odometry.process(
      {stamp_ns, test::kPeriod_ns, false, f.sharp, f.less_sharp, f.flat, f.less_flat});
}

double shift_m(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).norm(); }
double turn_rad(const Pose& a, const Pose& b) {
  return log_so3(a.linear().transpose() * b.linear()).norm();
}

TEST(ScanToScan, FindsTheMotionBetweenSweepsOfAStandingSensor) {
  const Pose step = exp_se3((Vector6() << 0.12, -0.05, 0.02, 0.004, -0.003, 0.02).finished());
  ScanToScan odometry(false);
  Pose T = Pose::Identity();
  for (int k = 0; k < 6; ++k) {
    const ScanMotion found = feed(odometry, test::sweep_at(T, 0.005, 1 + k), k);
    EXPECT_EQ(found.matched, k > 0);
    if (k > 0) {
      EXPECT_LT(shift_m(found.step, step), 0.025) << k;
      EXPECT_LT(turn_rad(found.step, step), 0.005) << k;
    }
    T = T * step;
  }
}

// Mean distance of the points, seen from this pose, from the room's surfaces.
double off_surfaces_m(const PointVector& points, const Pose& T_map_lidar) {
  double sum = 0.0;
  for (const Point& p : points) {
    const Eigen::Vector3d at = p.position().cast<double>();
    const double range =
        test::range_in_room(T_map_lidar.translation(), T_map_lidar.linear() * at.normalized());
    sum += std::min(0.5, std::abs(range - at.norm()));
  }
  return sum / static_cast<double>(points.size());
}

TEST(ScanToScan, WithDeskewingFindsTheMotionWithinTheSweepsAndTheirMiddle) {
  const Vector6 twist = (Vector6() << 0.15, 0.03, 0.0, 0.0, 0.0, 0.06).finished();
  ScanToScan deskewing(true), rigid(false);
  Pose begin = Pose::Identity(), middle;
  ScanMotion found, without;
  for (int k = 0; k < 20; ++k) {
    const PointVector sweep = test::sweep([&](double s) { return begin * exp_se3(s * twist); });
    found = feed(deskewing, sweep, k);
    without = feed(rigid, sweep, k);
    middle = begin * exp_se3(0.5 * twist);
    begin = begin * exp_se3(twist);
    if (k < 3) continue;
    EXPECT_LT(shift_m(found.step, exp_se3(twist)), 0.03) << k;
    EXPECT_LT(turn_rad(found.step, exp_se3(twist)), 0.006) << k;
  }
  EXPECT_LT(off_surfaces_m(found.planes, middle), 0.5 * off_surfaces_m(without.planes, middle));
}

TEST(ScanToScan, AMissingSweepDistortsNoOther) {
  const Vector6 twist = (Vector6() << 0.15, 0.03, 0.0, 0.0, 0.0, 0.06).finished();
  constexpr int kMissing = 10;
  ScanToScan deskewing(true), rigid(false);
  for (int k = 0; k <= kMissing + 1; ++k) {
    if (k == kMissing) continue;
    const Pose begin = exp_se3(static_cast<double>(k) * twist);
    const PointVector sweep = test::sweep([&](double s) { return begin * exp_se3(s * twist); });
    const ScanMotion found = feed(deskewing, sweep, k);
    const ScanMotion without = feed(rigid, sweep, k);
    if (k <= kMissing) continue;
    EXPECT_EQ(found.periods, 2.0);
    EXPECT_LT(shift_m(found.step, exp_se3(2.0 * twist)), 0.05);
    const Pose middle = begin * exp_se3(0.5 * twist);
    EXPECT_LT(off_surfaces_m(found.planes, middle), 0.5 * off_surfaces_m(without.planes, middle));
  }
}

TEST(ScanToScan, TwoLongGapsInARowPredictNoMoreThanTheLimit) {
  constexpr int kGap = 12;
  constexpr double kLimit = 10.0;
  const Eigen::Vector3d step_m(0.05, 0.0, 0.0);
  ScanToScan odometry(false);
  ScanMotion before, predicted;
  for (const int k : {0, 1, 2, 2 + kGap}) {
    Pose T = Pose::Identity();
    T.translation() = static_cast<double>(k) * step_m;
    before = feed(odometry, test::sweep_at(T), k);
  }
  ASSERT_TRUE(before.matched);
  ASSERT_EQ(before.periods, kGap);
  predicted = feed(odometry, {}, 2 + 2 * kGap);
  EXPECT_FALSE(predicted.matched);
  EXPECT_NEAR(predicted.step.translation().norm(), before.step.translation().norm() * kLimit / kGap,
              1e-6);
}

TEST(ScanToScan, NamesTheInstantOfItsPose) {
  const ScanView recorded{0, test::kPeriod_ns, false, {}, {}, {}, {}};
  const ScanView moved_to_end{0, test::kPeriod_ns, true, {}, {}, {}, {}};
  EXPECT_EQ(ScanToScan::instant_ns(recorded), test::kPeriod_ns / 2);
  EXPECT_EQ(ScanToScan::instant_ns(moved_to_end), test::kPeriod_ns);
}

TEST(ScanToScan, GoesOnOverASweepWithoutPoints) {
  const Pose step = exp_se3((Vector6() << 0.1, 0.0, 0.0, 0.0, 0.0, 0.01).finished());
  ScanToScan odometry(false);
  Pose T = Pose::Identity();
  for (int k = 0; k < 8; ++k) {
    const PointVector sweep = k == 5 ? PointVector{} : test::sweep_at(T);
    const ScanMotion found = feed(odometry, sweep, k);
    EXPECT_EQ(found.matched, k != 0 && k != 5) << k;
    EXPECT_LT(shift_m(found.T_odom_lidar, T), 0.08) << k;
    T = T * step;
  }
}

TEST(ScanToScan, AnotherInstanceGoesOnWithTheSameBytes) {
  const Pose step = exp_se3((Vector6() << 0.1, 0.0, 0.0, 0.0, 0.0, 0.02).finished());
  ScanToScan one(false), other(false);
  Pose T = Pose::Identity();
  ScanMotion last;
  for (int k = 0; k < 4; ++k, T = T * step) last = feed(one, test::sweep_at(T), k);
  other.restore(last);
  const PointVector next = test::sweep_at(T);
  EXPECT_EQ(feed(one, next, 4).T_odom_lidar.matrix(), feed(other, next, 4).T_odom_lidar.matrix());
}

TEST(RingTarget, ALineHasTwoDifferentPoints) {
  const auto point = [](float y, std::uint16_t ring) {
    return Point{1.0F, y, 0.0F, 0.0F, 0, ring, ReturnType::kStrongest, 0};
  };
  const PointVector rounded = {point(0.0F, 0), point(0.0F, 1), point(0.5F, 2)};
  const auto line = RingTarget(rounded).line_near({1.0, 0.0, 0.0});
  ASSERT_TRUE(line);
  EXPECT_EQ(((*line)[0] - (*line)[1]).norm(), 0.5);
}

TEST(MotionProblem, SaysThatThereIsNoSolution) {
  const Eigen::Vector3d point(1.0, 2.0, 3.0), a(4.0, -1.0, 0.5);
  Motion motion;
  MotionProblem problem(motion);
  problem.add(LineCost::create(point, a, a, 1.0));
  const Solved solved = problem.solve();
  EXPECT_FALSE(solved.usable);
  EXPECT_EQ(solved.residual_m, 0.0);
  EXPECT_EQ(motion.t, Eigen::Vector3d::Zero().eval());
}

TEST(CostFunctions, AreTheDistancesFromLineAndPlane) {
  const Eigen::Vector3d point(1.0, 2.0, 3.0), a(4.0, -1.0, 0.5), b(4.5, 2.0, 0.0), c(0.0, 1.0, 7.0);
  const Eigen::Quaterniond q(Eigen::AngleAxisd(0.3, Eigen::Vector3d(1.0, 2.0, -1.0).normalized()));
  const Eigen::Vector3d t(0.2, -0.4, 0.1);
  const Eigen::Vector3d p = q * point + t;
  Eigen::Vector3d line;
  ASSERT_TRUE(LineCost(point, a, b, 1.0)(q.coeffs().data(), t.data(), line.data()));
  EXPECT_NEAR(line.norm(), (Eigen::ParametrizedLine<double, 3>::Through(a, b).distance(p)), 1e-12);
  const Eigen::Vector3d normal = (a - b).cross(a - c).normalized();
  double plane = 0.0;
  ASSERT_TRUE(PlaneCost(point, a, normal, 1.0)(q.coeffs().data(), t.data(), &plane));
  const auto truth = Eigen::Hyperplane<double, 3>::Through(a, b, c);
  EXPECT_NEAR(std::abs(plane), truth.absDistance(p), 1e-12);
  double offset = 0.0;
  const NormalCost by_normal(point, truth.normal(), truth.offset());
  ASSERT_TRUE(by_normal(q.coeffs().data(), t.data(), &offset));
  EXPECT_NEAR(std::abs(offset), truth.absDistance(p), 1e-12);
}

TEST(CostFunctions, AShareOfTheMotionIsThatShareOfTurnAndShift) {
  const Eigen::Vector3d axis = Eigen::Vector3d(0.0, 1.0, 1.0).normalized();
  const Eigen::Quaterniond q(Eigen::AngleAxisd(0.4, axis));
  const Eigen::Vector3d t(0.2, -0.4, 0.1), point(3.0, 1.0, 2.0);
  const Eigen::Vector3d found = moved_by(q.coeffs().data(), t.data(), point, 0.25);
  const Eigen::Vector3d truth = Eigen::AngleAxisd(0.1, axis) * point + 0.25 * t;
  EXPECT_LT((found - truth).norm(), 1e-12);
}

}  // namespace
}  // namespace zloam::aloam
