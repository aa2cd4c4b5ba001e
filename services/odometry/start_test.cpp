// Start of the odometry: at any speed, and with a part of a revolution.

#include <gtest/gtest.h>

#include <cstring>
#include <vector>

#include "odometry/test_room.hpp"

namespace zloam::odometry {
namespace {

// A long street between two walls; only the ends of a few boxes constrain the position along it.
TestWorld street() {
  TestWorld world{.room = {{-200, -7, -1.6}, {200, 8, 30}}, .boxes = {}};
  double x = -60.0;
  for (int i = 0; x < 120.0; ++i) {
    const double y = i % 2 == 0 ? 5.4 : -7.0;
    world.boxes.push_back({{x, y, -1.6}, {x + 2.0, y + 2.6, 3.0}});
    x += 5.0 + 1.7 * (i % 3);
  }
  return world;
}

Vector6 along_x(double speed_mps) {
  Vector6 twist = Vector6::Zero();
  twist[0] = speed_mps;
  return twist;
}

struct Start {
  std::vector<OdometryResult> results;
  std::vector<FeatureSweep> sweeps;
  std::vector<PointVector> points;
};

// Input from a driver that is opened after this share of the sensor's revolution: the stamp of the
// partial sweep is that of its first point, its period the measured one.
Start begun_after(double share, const TestWorld& world, const Vector6& twist_per_s, int sweeps) {
  const TestSensor sensor{.columns = 450, .noise_m = 0.01};
  Start start;
  for (int k = 0; k < sweeps; ++k) {
    start.points.push_back(
        sweep_of(world, sensor, exp_se3(twist_per_s * (0.1 * k)), twist_per_s, 100U + unsigned(k)));
  }
  const auto begin_ns = static_cast<std::uint32_t>(share * sensor.period_ns);
  std::erase_if(start.points[0], [&](const Point& p) { return p.time_ns < begin_ns; });
  for (Point& p : start.points[0]) p.time_ns -= begin_ns;
  for (int k = 0; k < sweeps; ++k) {
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = 1000000000LL * 1000 + k * 100000000LL + (k == 0 ? begin_ns : 0);
    sweep.range_noise_m = sensor.noise_m;
    sweep.less_flat = start.points[std::size_t(k)];
    start.sweeps.push_back(sweep);
  }
  Odometry odometry({}, Pose::Identity());
  for (const FeatureSweep& sweep : start.sweeps) start.results.push_back(odometry.process(sweep));
  return start;
}

// Largest error of the motion since sweep `from`.
double error_m(const Start& start, const Vector6& twist_per_s, std::size_t from) {
  double greatest_m = 0.0;
  for (std::size_t k = from; k < start.results.size(); ++k) {
    const Pose moved = start.results[from].T_odom_base.inverse() * start.results[k].T_odom_base;
    const Pose truth = exp_se3(twist_per_s * (0.1 * double(k - from)));
    greatest_m = std::max(greatest_m, (truth.inverse() * moved).translation().norm());
  }
  return greatest_m;
}

TEST(OdometryStart, AtAnySpeedInAStreet) {
  for (double speed_mps : {0.0, 3.0, 6.0, -6.0, 9.0, 12.0, 15.0}) {
    const Start start = begun_after(0.0, street(), along_x(speed_mps), 6);
    EXPECT_LT(error_m(start, along_x(speed_mps), 0), 0.05) << speed_mps;
  }
}

TEST(OdometryStart, APieceOfATurnIsNotBegunWith) {
  Vector6 twist = along_x(8.0);
  twist[5] = 0.3;
  for (double share : {0.2, 0.5, 0.9, 0.99}) {
    const Start start = begun_after(share, street(), twist, 8);
    EXPECT_EQ(start.results[0].health, Health::kPredicted) << share;
    EXPECT_TRUE(start.results[0].planes.empty()) << share;
    EXPECT_EQ(start.results[1].health, Health::kOk) << share;
    EXPECT_EQ(start.results[1].prev_sweep, 1U) << "nothing is known of the motion before";
    EXPECT_LT(error_m(start, twist, 1), 0.05) << share;
  }
}

// A sensor that sees only a part of the revolution never delivers a whole one.
TEST(OdometryStart, HalfAViewIsBegunWithAtTheSecondSweep) {
  const Vector6 twist = along_x(1.0);
  const TestSensor sensor{.columns = 900, .noise_m = 0.01};
  Odometry odometry({}, Pose::Identity());
  Start start;
  for (int k = 0; k < 6; ++k) {
    PointVector points =
        sweep_of({}, sensor, exp_se3(twist * (0.1 * k)), twist, 100U + unsigned(k));
    std::erase_if(points, [&](const Point& p) { return p.time_ns > sensor.period_ns / 2; });
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    start.results.push_back(odometry.process(sweep));
    EXPECT_EQ(start.results.back().health, k == 0 ? Health::kPredicted : Health::kOk) << k;
  }
  EXPECT_LT(error_m(start, twist, 1), 0.05);
}

TEST(OdometryStart, WhoTakesOverAfterAPieceGoesOnWithTheSameBytes) {
  const Start start = begun_after(0.6, street(), along_x(8.0), 6);
  for (std::size_t taken_at = 1; taken_at < start.results.size(); ++taken_at) {
    std::vector<CommittedSweep> commits;
    for (std::size_t i = 0; i < taken_at; ++i) {
      commits.push_back(committed(start.results[i], start.sweeps[i].period_ns));
    }
    Odometry second({}, Pose::Identity());
    second.restore(commits);
    for (std::size_t k = taken_at; k < start.results.size(); ++k) {
      const OdometryResult r = second.process(start.sweeps[k]);
      EXPECT_EQ(0, std::memcmp(r.T_odom_base.data(), start.results[k].T_odom_base.data(),
                               sizeof(double) * 16))
          << taken_at << ' ' << k;
    }
  }
}

// A lidar may be connected, or uncovered, some sweeps before its first points.
TEST(OdometryStart, EmptySweepsBeforeTheFirstPointsLeaveNoTrace) {
  const Start start = begun_after(0.6, street(), along_x(8.0), 5);
  std::vector<FeatureSweep> sweeps(2);
  sweeps.insert(sweeps.end(), start.sweeps.begin(), start.sweeps.end());
  Odometry first({}, Pose::Identity());
  std::vector<OdometryResult> results;
  for (std::size_t k = 0; k < sweeps.size(); ++k) {
    sweeps[k].sweep = k;
    if (k < 2) sweeps[k].stamp_ns = start.sweeps[0].stamp_ns - 100000000LL * std::int64_t(2 - k);
    results.push_back(first.process(sweeps[k]));
  }
  EXPECT_EQ(results[1].health, Health::kEmpty);
  EXPECT_EQ(results[2].health, Health::kPredicted) << "still a part of a revolution";
  EXPECT_EQ(results[3].prev_sweep, 3U);
  std::vector<CommittedSweep> commits;
  for (std::size_t k = 1; k + 1 < sweeps.size(); ++k) {
    commits.push_back(committed(results[k - 1], sweeps[k - 1].period_ns));
    Odometry second({}, Pose::Identity());
    second.restore(commits);
    const OdometryResult next = second.process(sweeps[k]);
    EXPECT_EQ(next.prev_sweep, results[k].prev_sweep) << k;
    EXPECT_EQ(next.health, results[k].health) << k;
    EXPECT_EQ(next.T_odom_base.matrix(), results[k].T_odom_base.matrix()) << k;
    EXPECT_EQ(next.covariance, results[k].covariance) << k;
  }
}

}  // namespace
}  // namespace zloam::odometry
