#include "simulator/trajectory.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <stdexcept>

#include "simulator/path.hpp"
#include "simulator/random.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr double kStep = 1e-5;

std::vector<std::string> world_names() {
  std::vector<std::string> names;
  for (const SceneInfo& world : scene_list()) {
    names.push_back(world.name);
  }
  return names;
}

class EveryWorld : public testing::TestWithParam<std::string> {
 protected:
  std::shared_ptr<const Scene> scene = make_scene(GetParam(), {.seed = 4});
  const Trajectory& trajectory = scene->trajectory;
};

TEST_P(EveryWorld, DerivativesAreThoseOfThePose) {
  Random random(7, Stream::kTrajectory);
  for (int i = 0; i < 300; ++i) {
    const double t = random.uniform(0.01, trajectory.duration_s() - 0.01);
    const MotionState before = trajectory.at(t - kStep);
    const MotionState now = trajectory.at(t);
    const MotionState after = trajectory.at(t + kStep);
    const Vector3d velocity =
        (after.T_world_body.translation() - before.T_world_body.translation()) / (2.0 * kStep);
    const Vector3d acceleration = (after.velocity_world - before.velocity_world) / (2.0 * kStep);
    const Vector3d rate =
        log_so3(before.T_world_body.linear().transpose() * after.T_world_body.linear()) /
        (2.0 * kStep);
    EXPECT_LT((velocity - now.velocity_world).norm(), 1e-5);
    EXPECT_LT((acceleration - now.acceleration_world).norm(), 2e-2);
    EXPECT_LT((rate - now.rate_body).norm(), 1e-5);
  }
}

TEST_P(EveryWorld, VelocityAndAccelerationAreContinuousAcrossKnots) {
  for (double t = 0.02; t < trajectory.duration_s() - 0.02; t += 0.02) {
    const MotionState before = trajectory.at(t - 1e-9);
    const MotionState after = trajectory.at(t + 1e-9);
    ASSERT_LT((after.velocity_world - before.velocity_world).norm(), 1e-6) << t;
    ASSERT_LT((after.acceleration_world - before.acceleration_world).norm(), 1e-4) << t;
    ASSERT_LT((after.rate_body - before.rate_body).norm(), 1e-6) << t;
  }
}

TEST_P(EveryWorld, StandsStillAtFirstAndAtLast) {
  const Pose start = trajectory.at(0.0).T_world_body;
  for (double t = 0.0; t <= 1.5; t += 0.01) {
    const MotionState state = trajectory.at(t);
    ASSERT_LT((state.T_world_body.translation() - start.translation()).norm(), 1e-6) << t;
    ASSERT_LT(log_so3(start.linear().transpose() * state.T_world_body.linear()).norm(), 1e-6) << t;
  }
  EXPECT_LT(trajectory.at(trajectory.duration_s()).velocity_world.norm(), 1e-9);
}

TEST_P(EveryWorld, KeepsItsLimitsAndMoves) {
  double fastest = 0.0;
  double hardest = 0.0;
  double quickest = 0.0;
  double length = 0.0;
  for (double t = 0.0; t < trajectory.duration_s(); t += 0.005) {
    const MotionState state = trajectory.at(t);
    fastest = std::max(fastest, state.velocity_world.norm());
    hardest = std::max(hardest, state.acceleration_world.norm());
    quickest = std::max(quickest, state.rate_body.norm() * 180.0 / pi);
    length += 0.005 * state.velocity_world.norm();
  }
  EXPECT_LT(fastest, 7.8);
  EXPECT_LT(hardest, 8.0);
  EXPECT_LT(quickest, GetParam() == "handheld" ? 200.0 : 110.0);
  EXPECT_GT(quickest, GetParam() == "handheld" ? 150.0 : 0.0);
  EXPECT_GT(length, 20.0);
}

TEST_P(EveryWorld, NothingStandsInTheWay) {
  // From every pose the nearest surface in every direction is beyond the sensor's minimum range.
  for (double t = 0.0; t < trajectory.duration_s(); t += 0.2) {
    const Vector3d p = trajectory.at(t).T_world_body.translation();
    for (int k = 0; k < 72; ++k) {
      const double a = 2.0 * pi * k / 72.0;
      const Hit hit = scene->world.cast({p, {std::cos(a), std::sin(a), 0.0}}, 100.0);
      ASSERT_TRUE(!hit || hit.range_m > 0.3) << "at " << t << " s";
    }
  }
}

TEST_P(EveryWorld, LoopsClose) {
  const std::string& name = GetParam();
  const double gap = (trajectory.at(trajectory.duration_s()).T_world_body.translation() -
                      trajectory.at(0.0).T_world_body.translation())
                         .norm();
  if (name.starts_with("tunnel")) {
    EXPECT_GT(gap, 80.0);
  } else {
    EXPECT_LT(gap, 0.05);
  }
}

INSTANTIATE_TEST_SUITE_P(Worlds, EveryWorld, testing::ValuesIn(world_names()),
                         [](const auto& param) { return param.param; });

TEST(CubicSpline, PassesThroughItsKnotsAndIsNatural) {
  using Spline = CubicSpline<1>;
  std::vector<Spline::Value> values;
  for (int i = 0; i < 20; ++i) {
    values.emplace_back(std::sin(0.7 * i));
  }
  const Spline spline(values, 0.5);
  for (int i = 1; i < 19; ++i) {
    EXPECT_NEAR(spline.at(0.5 * i).value[0], values[static_cast<std::size_t>(i)][0], 1e-12);
  }
  EXPECT_NEAR(spline.at(1e-12).second[0], 0.0, 1e-9);
  EXPECT_NEAR(spline.at(9.5 - 1e-12).second[0], 0.0, 1e-9);
}

TEST(CubicSpline, FollowsASmoothFunction) {
  using Spline = CubicSpline<1>;
  std::vector<Spline::Value> values;
  for (int i = 0; i <= 200; ++i) {
    values.emplace_back(std::sin(0.05 * i));
  }
  const Spline spline(values, 0.05);
  for (double t = 2.0; t < 8.0; t += 0.013) {
    EXPECT_NEAR(spline.at(t).value[0], std::sin(t), 1e-6);
    EXPECT_NEAR(spline.at(t).first[0], std::cos(t), 1e-5);
    EXPECT_NEAR(spline.at(t).second[0], -std::sin(t), 1e-3);
  }
}

TEST(Path, RoundsCornersWithTheRadiusAskedFor) {
  const Path path = smooth_path({{0, 0}, {20, 0}, {20, 20}, {-20, 20}, {-20, 0}}, 5.0, 0.5, true);
  EXPECT_NEAR(path.length_m(), 120.0 - 8.0 * 5.0 + 2.0 * pi * 5.0, 0.2);
  const std::vector<double> heading = path.headings();
  EXPECT_NEAR(heading.back() - heading.front(), 2.0 * pi, 1e-6);
  double sharpest = 0.0;
  for (std::size_t i = 10; i + 10 < heading.size(); ++i) {
    sharpest = std::max(sharpest, (heading[i + 10] - heading[i - 10]) / (20.0 * path.spacing_m));
  }
  EXPECT_NEAR(1.0 / sharpest, 5.0, 0.15);
}

TEST(Path, GoesAroundSeveralTimesWithoutAStop) {
  const Path path = smooth_path({{0, 0}, {20, 0}, {20, 20}, {-20, 20}, {-20, 0}}, 5.0, 0.5, true);
  const Path twice = path.repeated(2);
  EXPECT_NEAR(twice.length_m(), 2.0 * path.length_m(), 1e-9);
  EXPECT_LT((twice.at(path.length_m() + 3.0) - path.at(3.0)).norm(), 1e-9);
  EXPECT_NEAR(twice.headings().back() - twice.headings().front(), 4.0 * pi, 1e-6);
  Drive drive_twice;
  drive_twice.laps = 2;
  const Trajectory trajectory = drive(path, drive_twice, 1);
  int stood = 0;
  for (double t = 4.0; t < trajectory.duration_s() - 2.0; t += 0.1) {
    stood += trajectory.at(t).velocity_world.norm() < 0.5 ? 1 : 0;
  }
  EXPECT_EQ(stood, 0);
}

TEST(Path, RefusesLapsWhereItDoesNotClose) {
  const Path path = smooth_path({{0, 0}, {20, 0}, {20, 20}}, 5.0, 0.5, false);
  EXPECT_THROW(path.repeated(2), std::invalid_argument);
  EXPECT_NO_THROW(path.repeated(1));
}

TEST(Path, RefusesCornersWithoutRoom) {
  const Polyline way = {{0, 0}, {20, 0}, {20, 1.3}, {0, 10}};
  EXPECT_THROW(smooth_path(way, 1.0, 0.5, false), std::invalid_argument);
  EXPECT_NO_THROW(smooth_path(way, 0.5, 0.5, false));
}

}  // namespace
}  // namespace zloam::simulator
