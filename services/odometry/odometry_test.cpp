#include "odometry/odometry.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <vector>

#include "odometry/test_room.hpp"

namespace zloam::odometry {
namespace {

struct Error {
  double position_m = 0.0;
  double rotation_rad = 0.0;
};

// Largest errors of the poses from sweep `from` on.
Error error_of(const Drive& d, std::size_t from = 0) {
  Error e;
  for (std::size_t k = from; k < d.results.size(); ++k) {
    const Pose off = d.truth_end[k].inverse() * d.results[k].T_odom_base;
    e.position_m = std::max(e.position_m, off.translation().norm());
    e.rotation_rad = std::max(e.rotation_rad, log_so3(off.linear()).norm());
  }
  return e;
}

Vector6 twist_along(int axis) {
  Vector6 twist = Vector6::Zero();
  twist[axis] = axis < 3 ? 1.0 : 0.8;
  return twist;
}

bool same_bytes(const OdometryResult& a, const OdometryResult& b) {
  const auto same = [](const auto& x, const auto& y) {
    return std::memcmp(x.data(), y.data(), sizeof(x)) == 0;
  };
  return a.planes.size() == b.planes.size() &&
         same(a.T_odom_base.matrix(), b.T_odom_base.matrix()) &&
         same(a.twist_per_s, b.twist_per_s) && same(a.covariance, b.covariance) &&
         std::memcmp(a.planes.data(), b.planes.data(), a.planes.size() * sizeof(Point)) == 0;
}

TEST(Odometry, KnownMotionAlongEachAxisWithoutNoise) {
  for (int axis = 0; axis < 6; ++axis) {
    const Drive d = drive({}, {}, {}, twist_along(axis), 8);
    const Error e = error_of(d);
    EXPECT_LT(e.position_m, 0.006) << "axis " << axis;
    EXPECT_LT(e.rotation_rad, 0.002) << "axis " << axis;
    EXPECT_LT((d.results.back().twist_per_s - twist_along(axis)).norm(), 0.03) << "axis " << axis;
  }
}

TEST(Odometry, KnownMotionAlongEachAxisWithNoise) {
  for (int axis = 0; axis < 6; ++axis) {
    const Drive d = drive({}, {.noise_m = 0.02}, {}, twist_along(axis), 15);
    const Error e = error_of(d);
    EXPECT_LT(e.position_m, 0.02) << "axis " << axis;
    EXPECT_LT(e.rotation_rad, 0.005) << "axis " << axis;
  }
}

TEST(Odometry, CombinedMotionAndSlowSensor) {
  Vector6 twist;
  twist << 1.2, -0.3, 0.1, 0.1, -0.2, 0.9;
  const Drive fast = drive({}, {.noise_m = 0.02}, {}, twist, 12);
  EXPECT_LT(error_of(fast).position_m, 0.02);
  const Drive slow = drive({}, {.period_ns = 200000000, .noise_m = 0.02}, {}, twist, 8);
  EXPECT_LT(error_of(slow).position_m, 0.03);
}

constexpr double kNod_hz = 1.2;
constexpr double kNod_rad = 0.05;

// Rms rotation error at the ends of the sweeps, rad, of a sensor that nods after half a second of
// rest.
double nodding_error_rad() {
  const Motion nodding = [](double time_s) {
    const double phase = 2.0 * std::numbers::pi * kNod_hz * std::max(0.0, time_s - 0.5);
    Pose at = Pose::Identity();
    at.linear() = exp_so3({0.0, kNod_rad * (1.0 - std::cos(phase)), 0.0});
    return at;
  };
  const Drive d = drive_along({}, {.noise_m = 0.01}, {}, nodding, 40);
  double sum = 0.0;
  constexpr std::size_t kFrom = 10;
  for (std::size_t k = kFrom; k < d.results.size(); ++k) {
    const Pose off = d.truth_end[k].inverse() * d.results[k].T_odom_base;
    sum += log_so3(off.linear()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(d.results.size() - kFrom));
}

TEST(Odometry, ATurnThatChangesWithinASweepIsFollowed) {
  // The best constant twist through a sweep of the angular acceleration alpha leaves
  // alpha T^2 / 12 at its ends.
  const double rate = 2.0 * std::numbers::pi * kNod_hz;
  const double alpha_rms = kNod_rad * rate * rate / std::numbers::sqrt2;
  const double constant_twist_rad = alpha_rms * 0.1 * 0.1 / 12.0;
  EXPECT_LT(nodding_error_rad(), 0.6 * constant_twist_rad);
}

TEST(Odometry, MountingDoesNotChangeTheMotionOfTheBase) {
  Vector6 twist;
  twist << 1.0, 0.2, 0.0, 0.0, 0.1, 0.6;
  for (const Eigen::Vector3d& rpy : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(180, 0, 0),
                                     Eigen::Vector3d(0, 30, 0), Eigen::Vector3d(12, -20, 135)}) {
    TestSensor sensor;
    sensor.noise_m = 0.01;
    sensor.T_base_lidar = pose_from_xyz_rpy_deg({0.3, -0.1, 0.2}, rpy);
    const Drive d = drive({}, sensor, {}, twist, 8);
    EXPECT_LT(error_of(d).position_m, 0.02) << rpy.transpose();
    EXPECT_LT(error_of(d).rotation_rad, 0.005) << rpy.transpose();
    EXPECT_LT((d.results.back().twist_per_s - twist).norm(), 0.1) << rpy.transpose();
  }
}

TEST(Odometry, CloudsLieOnTheSurfacesAtTheInstant) {
  Vector6 twist;
  twist << 2.0, 0.0, 0.0, 0.0, 0.0, 1.5;
  const TestWorld world{.room = {{-9, -6, -1.2}, {8, 7, 2.3}}, .boxes = {}};
  const Drive d = drive(world, {}, {}, twist, 6);
  const OdometryResult& r = d.results.back();
  const Pose T_world_base = exp_se3(twist * 0.6);
  double worst = 0.0;
  // The sweep has 16 rings of 900 points.
  ASSERT_GT(r.planes.size(), 1000U);
  for (const Point& p : r.planes) {
    const Eigen::Vector3d w = T_world_base * p.position().cast<double>();
    const double off =
        std::min({std::abs(w.x() + 9), std::abs(w.x() - 8), std::abs(w.y() + 6),
                  std::abs(w.y() - 7), std::abs(w.z() + 1.2), std::abs(w.z() - 2.3)});
    worst = std::max(worst, off);
  }
  // Without deskewing the far walls would be off by 2 m/s * 0.1 s.
  EXPECT_LT(worst, 0.03);
  EXPECT_EQ(r.instant_ns, 1000000000LL * 1000 + 6 * 100000000LL);
}

TEST(Odometry, CovarianceCoversTheErrorWithinAnOrderOfMagnitude) {
  Vector6 twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  const Drive d = drive({}, {.noise_m = 0.02}, {}, twist, 30);
  double nees = 0.0;
  for (std::size_t k = 10; k < d.results.size(); ++k) {
    const Pose step = d.results[k - 1].T_odom_base.inverse() * d.results[k].T_odom_base;
    const Pose true_step = d.truth_end[k - 1].inverse() * d.truth_end[k];
    const Vector6 e = log_se3(true_step.inverse() * step);
    nees += e.dot(d.results[k].covariance.ldlt().solve(e)) / 6.0 / 20.0;
    EXPECT_GT(d.results[k].covariance.ldlt().vectorD().minCoeff(), 0.0);
  }
  EXPECT_LT(nees, 10.0);
  EXPECT_GT(nees, 0.01);
}

TEST(Odometry, EndlessCorridorIsFlaggedAlongItsAxis) {
  const TestWorld corridor{.room = {{-1000, -2, -1.2}, {1000, 2, 2.3}}, .boxes = {}};
  Vector6 twist = Vector6::Zero();
  const Drive d = drive(corridor, {.noise_m = 0.02}, {}, twist, 6);
  const OdometryResult& r = d.results.back();
  EXPECT_EQ(r.health, Health::kDegenerate);
  EXPECT_TRUE(r.degeneracy.degenerate);
  EXPECT_GT(std::abs(r.degeneracy.weak_translation.x()), 0.99);
  EXPECT_GT(r.degeneracy.sigma_measured, r.degeneracy.sigma_predicted);
  // The degenerate direction keeps the prediction, the constrained ones are measured.
  const Vector6& before = d.results[d.results.size() - 2].twist_per_s;
  EXPECT_LT(std::abs(r.twist_per_s.x() - before.x()), 0.5);
  const Eigen::Vector3d off = r.T_odom_base.translation() - d.truth_end.back().translation();
  EXPECT_LT(off.tail<2>().norm(), 0.01);
  const Drive room = drive({}, {.noise_m = 0.02}, {}, twist, 6);
  EXPECT_FALSE(room.results.back().degeneracy.degenerate);
}

TEST(Odometry, EmptySweepIsPredictedAndTheNextOneGoesOn) {
  Vector6 twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  Odometry odometry({}, Pose::Identity());
  OdometryResult r;
  for (int k = 0; k < 10; ++k) {
    const PointVector points =
        k == 6 ? PointVector{}
               : sweep_of({}, {.noise_m = 0.01}, exp_se3(twist * (0.1 * k)), twist, unsigned(k));
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    r = odometry.process(sweep);
    EXPECT_EQ(r.health, k == 6 ? Health::kEmpty : Health::kOk) << k;
    const Pose truth = exp_se3(twist * (0.1 * k));
    EXPECT_LT((truth.inverse() * r.T_odom_base).translation().norm(), 0.03) << k;
    EXPECT_EQ(r.prev_sweep, std::uint64_t(k == 0 ? 0 : k - 1));
  }
}

TEST(Odometry, DroppedSweepsAreBridgedByTheirTimes) {
  Vector6 twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  Odometry odometry({}, Pose::Identity());
  for (int k = 0; k < 16; ++k) {
    if (k == 7 || k == 8 || k == 12) continue;
    const PointVector points =
        sweep_of({}, {.noise_m = 0.01}, exp_se3(twist * (0.1 * k)), twist, unsigned(k));
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    const OdometryResult r = odometry.process(sweep);
    EXPECT_EQ(r.health, Health::kOk);
    EXPECT_LT((exp_se3(twist * (0.1 * k)).inverse() * r.T_odom_base).translation().norm(), 0.03);
  }
}

// Sweeps of another place, as after a kidnapping: no pose near the prediction explains them.
TEST(Odometry, SweepsThatFitNowhereAreLostAndTheNextThatFitIsNot) {
  TestWorld elsewhere;
  elsewhere.room = {{-4, -3, -1.2}, {14, 2.5, 3.5}};
  elsewhere.boxes = {{{1, -2, -1.2}, {2, 0, 1.5}}, {{-3, 0.5, -1.2}, {-1, 2, 2}}};
  Vector6 twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  Odometry odometry({}, Pose::Identity());
  for (int k = 0; k < 16; ++k) {
    const bool away = k == 8 || k == 9;
    const PointVector points = sweep_of(away ? elsewhere : TestWorld{}, {.noise_m = 0.01},
                                        exp_se3(twist * (0.1 * k)), twist, unsigned(k));
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    const OdometryResult r = odometry.process(sweep);
    EXPECT_EQ(r.health, away ? Health::kLost : Health::kOk) << k;
    EXPECT_LT((exp_se3(twist * (0.1 * k)).inverse() * r.T_odom_base).translation().norm(), 0.03)
        << k;
  }
}

TEST(Odometry, OddInputPassesWithAFinitePose) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const PointVector room = sweep_of({}, {}, Pose::Identity(), Vector6::Zero(), 1);
  const PointVector one_ring = sweep_of({}, {.rings = 1}, Pose::Identity(), Vector6::Zero(), 1);
  const std::vector<PointVector> odd = {
      {},
      PointVector(100, Point{nan, nan, nan, 0, 0, 0, ReturnType::kStrongest, 0}),
      PointVector(1, Point{1, 2, 3, 0, 0, 0, ReturnType::kStrongest, 0}),
      PointVector(5000, Point{1, 2, 3, 0, 5, 1, ReturnType::kStrongest, 0}),
      PointVector(5000, Point{3e38F, -3e38F, 1e30F, 0, 4000000000U, 65535, ReturnType::kLast, 0}),
      one_ring};
  for (const PointVector& first : odd) {
    for (const PointVector& second : odd) {
      Odometry odometry({}, Pose::Identity());
      std::uint64_t number = 0;
      for (const PointVector* points : {&first, &second, &room, &second}) {
        FeatureSweep sweep;
        sweep.sweep = number;
        sweep.stamp_ns = std::int64_t(number++) * 100000000;
        sweep.less_sharp = sweep.less_flat = *points;
        const OdometryResult r = odometry.process(sweep);
        EXPECT_TRUE(r.T_odom_base.matrix().allFinite());
        EXPECT_TRUE(r.covariance.allFinite());
        EXPECT_LT(r.T_odom_base.translation().norm(), 5.0);
        EXPECT_TRUE(!points->empty() || r.health == Health::kEmpty);
      }
    }
  }
}

TEST(Odometry, ClockJumpsAndZeroPeriodAreSurvived) {
  const PointVector room = sweep_of({}, {}, Pose::Identity(), Vector6::Zero(), 1);
  Odometry odometry({}, Pose::Identity());
  std::uint64_t number = 0;
  for (std::int64_t stamp : {0LL, 100000000LL, 900000000000000LL, -5LL, 100LL}) {
    FeatureSweep sweep;
    sweep.sweep = number++;
    sweep.stamp_ns = stamp;
    sweep.period_ns = number == 4 ? 0 : 100000000;
    sweep.less_flat = room;
    const OdometryResult r = odometry.process(sweep);
    EXPECT_TRUE(r.T_odom_base.matrix().allFinite());
    EXPECT_LT(r.T_odom_base.translation().norm(), 0.2);
  }
}

// A source that has not measured a revolution yet, or sends an empty cloud, knows no period.
TEST(Odometry, AnEmptySweepWithoutAPeriodKeepsTheMotion) {
  Vector6 twist;
  twist << 2.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  for (int empty : {0, 6}) {
    Odometry odometry({}, Pose::Identity());
    for (int k = 0; k < 9; ++k) {
      const PointVector points =
          sweep_of({}, {.noise_m = 0.01}, exp_se3(twist * (0.1 * (k - 6))), twist, unsigned(k));
      FeatureSweep sweep;
      sweep.sweep = std::uint64_t(k);
      sweep.stamp_ns = k * 100000000LL;
      if (k == empty) sweep.period_ns = 0;
      if (k != empty) sweep.less_flat = points;
      const OdometryResult r = odometry.process(sweep);
      EXPECT_EQ(r.health, k == empty ? Health::kEmpty : Health::kOk) << k;
      EXPECT_TRUE(r.covariance.allFinite()) << k;
      if (k <= 3) continue;
      EXPECT_NEAR(r.twist_per_s[0], 2.0, 0.2) << k;
    }
  }
}

TEST(Odometry, SameSweepsSameBytes) {
  Vector6 twist;
  twist << 1.0, 0.0, 0.1, 0.1, 0.0, 0.5;
  const Drive a = drive({}, {.noise_m = 0.02}, {}, twist, 6);
  const Drive b = drive({}, {.noise_m = 0.02}, {}, twist, 6);
  for (std::size_t k = 0; k < a.results.size(); ++k) {
    EXPECT_TRUE(same_bytes(a.results[k], b.results[k])) << k;
  }
}

TEST(Odometry, AnotherInstanceTakesOverFromTheResultsWithTheSameBytes) {
  Vector6 twist;
  twist << 1.0, 0.0, 0.1, 0.1, 0.0, 0.5;
  OdometryConfig config;
  config.window_sweeps = 4;
  for (int taken_at : {1, 3, 7}) {
    Odometry first(config, Pose::Identity());
    Odometry second(config, Pose::Identity());
    std::vector<OdometryResult> results;
    for (int k = 0; k < 9; ++k) {
      const PointVector points = sweep_of({}, {.columns = 300, .noise_m = 0.01},
                                          exp_se3(twist * (0.1 * k)), twist, unsigned(k));
      FeatureSweep sweep;
      sweep.sweep = std::uint64_t(k);
      sweep.stamp_ns = k * 100000000LL;
      sweep.less_flat = points;
      if (k == taken_at) {
        std::vector<CommittedSweep> commits;
        const std::size_t depth = std::min(results.size(), second.restore_depth());
        for (std::size_t i = results.size() - depth; i < results.size(); ++i) {
          commits.push_back(committed(results[i], sweep.period_ns));
        }
        second.restore(commits);
      }
      results.push_back(first.process(sweep));
      if (k >= taken_at) {
        EXPECT_TRUE(same_bytes(results.back(), second.process(sweep))) << taken_at << ' ' << k;
      }
    }
  }
}

/// The part of the revolution in which a sensor sees, and its speed, m/s.
struct Narrow {
  double from, to, speed_mps;
};

class NarrowView : public testing::TestWithParam<Narrow> {};
INSTANTIATE_TEST_SUITE_P(Views, NarrowView,
                         testing::Values(Narrow{0.0, 0.55, 0.8}, Narrow{0.0, 0.36, 0.0},
                                         Narrow{0.1, 0.4, 0.8}, Narrow{0.35, 0.65, 0.0},
                                         Narrow{0.64, 1.0, 0.0}, Narrow{0.7, 1.0, 0.8}));

// Points in a part of the sweep hardly constrain its end: an odometry that ties the next sweep to
// that end as if it were certain oscillates with growing amplitude.
TEST_P(NarrowView, DoesNotSwing) {
  const auto [from, to, speed_mps] = GetParam();
  Vector6 twist = Vector6::Zero();
  twist[0] = speed_mps;
  Odometry odometry({}, Pose::Identity());
  double worst_rad = 0.0, worst_m = 0.0;
  for (int k = 0; k < 60; ++k) {
    PointVector points =
        sweep_of({}, {.columns = 450, .noise_m = 0.02}, exp_se3(twist * (0.1 * k)), twist, k);
    std::erase_if(points, [&](const Point& p) {
      return p.time_ns < from * 100'000'000 || p.time_ns > to * 100'000'000;
    });
    FeatureSweep sweep;
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    const OdometryResult r = odometry.process(sweep);
    const Vector6 off = 0.1 * (r.twist_per_s - twist);
    if (k <= 10) continue;
    worst_rad = std::max(worst_rad, off.tail<3>().norm());
    worst_m = std::max(worst_m, off.head<3>().norm());
  }
  EXPECT_LT(worst_rad, 0.02);
  EXPECT_LT(worst_m, 0.05);
}

// Sweeps of a sensor at rest after a sweep with a wrong solution that rotates by more than a
// radian, as may happen on bare ground. Returns the rotation of the last pose from the first one,
// rad.
double turned_after_a_wrong_turn_rad(double max_turn_radps) {
  OdometryConfig config;
  config.max_turn_radps = max_turn_radps;
  Odometry odometry(config, Pose::Identity());
  FeatureSweep sweep;
  const auto sweep_at_rest = [&](int k) {
    const PointVector points = sweep_of({}, {.columns = 300, .noise_m = 0.01}, Pose::Identity(),
                                        Vector6::Zero(), unsigned(k));
    sweep.sweep = std::uint64_t(k);
    sweep.stamp_ns = k * 100000000LL;
    sweep.less_flat = points;
    return odometry.process(sweep);
  };
  // The commits refer to the points of these results.
  std::vector<OdometryResult> results;
  for (int k = 0; k < 5; ++k) results.push_back(sweep_at_rest(k));
  std::vector<CommittedSweep> commits;
  for (const OdometryResult& r : results) commits.push_back(committed(r, sweep.period_ns));
  commits.back().twist_per_s << 0.0, 0.0, 0.0, 0.0, 0.0, 25.0;
  odometry.restore(commits);
  OdometryResult last;
  for (int k = 5; k < 10; ++k) last = sweep_at_rest(k);
  return log_so3(last.T_odom_base.linear()).norm();
}

TEST(Odometry, AfterAWrongTurnTheRightOneIsFoundAgain) {
  EXPECT_LT(turned_after_a_wrong_turn_rad(OdometryConfig{}.max_turn_radps), 0.01);
  EXPECT_LT(turned_after_a_wrong_turn_rad(1000.0), 0.01) << "the search finds it, not the bound";
}

// Where the prediction rotates faster than any platform, rest is taken instead, as uncertain as
// they differ.
TEST(Odometry, RestInsteadOfAWrongTurnIsUncertain) {
  Odometry odometry({}, Pose::Identity());
  const PointVector room = sweep_of({}, {.columns = 300}, Pose::Identity(), Vector6::Zero(), 1);
  std::vector<OdometryResult> results;
  FeatureSweep sweep;
  const auto next = [&](PointSpan points) {
    sweep.sweep = results.size();
    sweep.stamp_ns = std::int64_t(results.size()) * 100000000;
    sweep.less_flat = points;
    results.push_back(odometry.process(sweep));
  };
  for (int k = 0; k < 4; ++k) next(room);
  std::vector<CommittedSweep> commits;
  for (const OdometryResult& r : results) commits.push_back(committed(r, sweep.period_ns));
  commits.back().twist_per_s << 10.0, 0.0, 0.0, 0.0, 0.0, 25.0;
  odometry.restore(commits);
  next({});
  const OdometryResult& at_rest = results.back();
  EXPECT_EQ(at_rest.health, Health::kEmpty);
  EXPECT_EQ(at_rest.twist_per_s, Vector6(Vector6::Zero()));
  EXPECT_GT(std::sqrt(at_rest.covariance(5, 5)), 2.0) << "a tenth of a second at 25 rad/s";
  EXPECT_GT(std::sqrt(at_rest.covariance.topLeftCorner<3, 3>().trace()), 0.5);
}

}  // namespace
}  // namespace zloam::odometry
