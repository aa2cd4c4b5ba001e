#include "simulator/world.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "simulator/random.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;

Vector3d any_direction(Random& random) {
  const double z = random.uniform(-1.0, 1.0);
  const double angle = random.uniform(0.0, 2.0 * std::numbers::pi);
  const double r = std::sqrt(1.0 - z * z);
  return {r * std::cos(angle), r * std::sin(angle), z};
}

TEST(Shape, BoxIsHitWhereTheClosedFormSays) {
  SceneBuilder builder;
  builder.box({10.0, 0.0, -1.0, 1.0, 2.0, 4.0, std::numbers::pi / 6.0});
  const Shape shape = builder.take().front();
  const auto crossing = cross({Vector3d::Zero(), Vector3d::UnitX()}, shape, 0);
  ASSERT_TRUE(crossing);
  // The face x' = -1 of the box rotated by 30 degrees: its normal is (cos 30, sin 30), so
  // (10 - t) cos 30 = 1.
  EXPECT_NEAR(crossing->range_m, 10.0 - 1.0 / std::cos(std::numbers::pi / 6.0), 1e-12);
  EXPECT_NEAR(crossing->cos_incidence, std::cos(std::numbers::pi / 6.0), 1e-12);
  EXPECT_FALSE(cross({Vector3d::Zero(), -Vector3d::UnitX()}, shape, 0));
}

TEST(Shape, BoxIsSeenFromInside) {
  SceneBuilder builder;
  builder.box({0.0, 0.0, -1.0, 1.0, 8.0, 6.0, 0.0});
  const Shape shape = builder.take().front();
  EXPECT_NEAR(cross({Vector3d::Zero(), Vector3d::UnitY()}, shape, 0)->range_m, 3.0, 1e-12);
}

TEST(Shape, CylinderHasAMantleAndNoCaps) {
  SceneBuilder builder;
  builder.cylinder(5.0, 0.0, 0.5, 0.0, 2.0, 50.0);
  const Shape shape = builder.take().front();
  EXPECT_NEAR(cross({{0, 0, 1}, Vector3d::UnitX()}, shape, 0)->range_m, 4.5, 1e-12);
  EXPECT_NEAR(cross({{0, 0.3, 1}, Vector3d::UnitX()}, shape, 0)->range_m, 4.6, 1e-12);
  EXPECT_FALSE(cross({{0, 0, 3}, Vector3d::UnitX()}, shape, 0));
  EXPECT_FALSE(cross({{5, 0, 9}, -Vector3d::UnitZ()}, shape, 0));
  // The ray passes over the near rim and hits the inside of the far wall.
  const auto over = cross({{0, 0, 2.5}, Vector3d(1, 0, -0.1).normalized()}, shape, 0);
  ASSERT_TRUE(over);
  EXPECT_NEAR(over->range_m, 5.5 * std::hypot(1.0, 0.1), 1e-12);
}

TEST(Shape, EllipsoidIsHitOnItsSurface) {
  SceneBuilder builder;
  const Vector3d half(2.0, 1.0, 0.5);
  builder.ellipsoid({6.0, 0.0, 0.0}, half, 50.0);
  const Shape shape = builder.take().front();
  EXPECT_NEAR(cross({Vector3d::Zero(), Vector3d::UnitX()}, shape, 0)->range_m, 4.0, 1e-12);
  const Vector3d d = Vector3d(6.0, 0.4, 0.1).normalized();
  const auto crossing = cross({Vector3d::Zero(), d}, shape, 0);
  ASSERT_TRUE(crossing);
  EXPECT_NEAR((crossing->range_m * d - shape.centre).cwiseQuotient(half).norm(), 1.0, 1e-12);
}

TEST(Shape, FoliageIsPenetratedByTheExponentialLaw) {
  SceneBuilder builder;
  builder.box({0.0, 0.0, -50.0, 50.0, 4.0, 100.0, 0.0});
  Shape shape = builder.take().front();
  for (const double density : {0.3, 0.7, 2.0, 6.0}) {
    shape.density_per_m = density;
    Random random(5, Stream::kWorld);
    const int rays = 20000;
    int hits = 0;
    double through = 0.0;
    double depth = 0.0;
    double expected_depth = 0.0;
    for (int i = 0; i < rays; ++i) {
      const Vector3d direction =
          Vector3d(1.0, random.uniform(-0.7, 0.7), random.uniform(-0.7, 0.7)).normalized();
      const Ray ray{{-9.0, random.uniform(-20.0, 20.0), random.uniform(-20.0, 20.0)}, direction};
      const double enter = 7.0 / direction.x();
      const double thick = 4.0 / direction.x();
      const double left = std::exp(-density * thick);
      through += left / rays;
      expected_depth += (1.0 / density * (1.0 - left) - thick * left) / rays;
      if (const auto crossing = cross(ray, shape, 3)) {
        ASSERT_GE(crossing->range_m, enter - 1e-9);
        ASSERT_LE(crossing->range_m, enter + thick + 1e-9);
        ASSERT_GE(crossing->cos_incidence, 0.0);
        ASSERT_LE(crossing->cos_incidence, 1.0 + 1e-9);
        ++hits;
        depth += (crossing->range_m - enter) / rays;
      }
    }
    EXPECT_NEAR(static_cast<double>(hits) / rays, 1.0 - through, 0.02) << density;
    // A ray hits a leaf at its front, not at its centre.
    EXPECT_NEAR(depth, expected_depth, 0.04 * expected_depth + 0.02) << density;
  }
}

TEST(Shape, LeavesStayWhereTheyAre) {
  SceneBuilder builder;
  builder.ellipsoid({5.0, 0.0, 0.0}, {1.5, 1.5, 1.5}, 40.0);
  Shape shape = builder.take().front();
  shape.density_per_m = 1.0;
  // Rays from any direction to a point that one ray has hit stop at this point or before, never
  // behind it.
  Random random(2, Stream::kWorld);
  int met = 0;
  int same = 0;
  for (int i = 0; i < 300; ++i) {
    const Vector3d d = Vector3d(5.0, random.uniform(-1, 1), random.uniform(-1, 1)).normalized();
    const auto crossing = cross({Vector3d::Zero(), d}, shape, 3);
    if (!crossing) {
      continue;
    }
    ++met;
    const Vector3d leaf = crossing->range_m * d;
    const Vector3d eye(0.0, random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2));
    const double distance = (leaf - eye).norm();
    const auto again = cross({eye, (leaf - eye) / distance}, shape, 3);
    ASSERT_TRUE(again);
    ASSERT_LT(again->range_m, distance + 1e-6);
    same += std::abs(again->range_m - distance) < 1e-6 ? 1 : 0;
    const auto other = cross({Vector3d::Zero(), d}, shape, 4);
    EXPECT_TRUE(!other || other->range_m != crossing->range_m);
  }
  EXPECT_GT(met, 150);
  EXPECT_GT(same, met / 2);
}

TEST(Shape, ReliefBelongsToThePlaceAndHasTheSigmaAskedFor) {
  SceneBuilder builder;
  Shape& wall = builder.box({0.0, 0.0, -50.0, 50.0, 2.0, 100.0, 0.4});
  wall.roughness_m = 0.02;
  const Shape shape = builder.take().front();
  Random random(6, Stream::kWorld);
  double squares = 0.0;
  double steps = 0.0;
  constexpr int kPlaces = 20000;
  for (int i = 0; i < kPlaces; ++i) {
    const Vector3d p(0.3, random.uniform(-40, 40), random.uniform(-40, 40));
    const double relief = relief_along(p, shape, 1, 1.0);
    EXPECT_EQ(relief, relief_along(p, shape, 1, 1.0));
    EXPECT_NEAR(relief_along(p, shape, 1, 0.5), 2.0 * relief, 1e-12);
    squares += relief * relief / kPlaces;
    const double step = relief_along(p + Vector3d(0.0, 0.001, 0.0), shape, 1, 1.0) - relief;
    steps += step * step / kPlaces;
  }
  EXPECT_NEAR(std::sqrt(squares), 0.02, 0.001);
  EXPECT_LT(std::sqrt(steps), 0.002) << "bumps, not noise";
  Shape smooth = shape;
  smooth.roughness_m = 0.0;
  EXPECT_EQ(relief_along(Vector3d::Zero(), smooth, 1, 1.0), 0.0);
}

TEST(Track, WalksAtItsSpeedAndRepeats) {
  const auto ground = [](double x, double) { return 0.1 * x; };
  const Track once = walk({{0, 0}, {10, 0}, {10, 5}}, 2.0, 0.0, Repeat::kOnce, ground);
  EXPECT_TRUE(once.at(2.1).place.isApprox(Vector3d(4.2, 0.0, 0.42), 1e-9));
  EXPECT_TRUE(once.at(2.1).velocity.isApprox(Vector3d(2.0, 0.0, 0.2), 1e-9));
  EXPECT_NEAR(once.at(6.1).yaw_rad, std::numbers::pi / 2.0, 1e-9);
  EXPECT_TRUE(once.at(60.0).place.isApprox(Vector3d(10.0, 5.0, 1.0), 1e-9));
  EXPECT_EQ(once.at(60.0).velocity.norm(), 0.0);
  const Track to_and_fro = walk({{0, 0}, {10, 0}}, 2.0, 3.0, Repeat::kToAndFro, nullptr);
  EXPECT_NEAR(to_and_fro.at(0.0).place.x(), 3.0, 1e-9);
  EXPECT_NEAR(to_and_fro.at(6.0).place.x(), 5.0, 1e-9);  // on its way back
  EXPECT_NEAR(to_and_fro.at(6.0).velocity.x(), -2.0, 1e-9);
  EXPECT_NEAR(to_and_fro.at(16.0).place.x(), 5.0, 1e-9);
  const Track loop = walk({{0, 0}, {4, 0}, {4, 4}, {0, 4}}, 1.0, 0.0, Repeat::kLoop, nullptr);
  EXPECT_TRUE(loop.at(14.0).place.isApprox(Vector3d(0.0, 2.0, 0.0), 1e-9));
  EXPECT_TRUE(loop.at(-2.0).place.isApprox(Vector3d(0.0, 2.0, 0.0), 1e-9));
  EXPECT_THROW(walk({{0, 0}}, 1.0, 0.0, Repeat::kLoop, nullptr), std::invalid_argument);
  EXPECT_THROW(walk({{0, 0}, {1, 0}}, 0.0, 0.0, Repeat::kLoop, nullptr), std::invalid_argument);
  EXPECT_EQ(Track().at(3.0).place.norm(), 0.0);
}

TEST(Moving, NothingComesTooNearToThePlatform) {
  const auto scene = make_scene("moving", {.seed = 7});
  const auto city = make_scene("city", {.seed = 7});
  EXPECT_GT(scene->world.movers().size(), 60U);
  double vans_moved = 0.0;
  for (double t = 0.0; t < scene->trajectory.duration_s(); t += 0.25) {
    const Pose pose = scene->trajectory.at(t).T_world_body;
    ASSERT_TRUE(pose.isApprox(city->trajectory.at(t).T_world_body, 1e-12)) << "the truth is city's";
    for (const MovingShape& moving : scene->world.moving_at(t)) {
      const Vector3d inside =
          moving.shape.R_world_shape.transpose() * (pose.translation() - moving.shape.centre);
      const Vector3d gap = inside.cwiseAbs() - moving.shape.half;
      ASSERT_GT(gap.head<2>().cwiseMax(0.0).norm(), 0.8) << "at " << t;
    }
    vans_moved += 0.25 * scene->world.movers().front().track.at(t).velocity.norm();
  }
  EXPECT_NEAR(vans_moved, 390.0, 20.0) << "goes with the platform all the way";
}

TEST(Terrain, HitsAreOnTheSurfaceAndNothingIsJumpedOver) {
  const Terrain ground({-60, -60}, {60, 60}, 1.0, {0.6, 0.2, 0.05}, 5);
  Random random(1, Stream::kWorld);
  int hits = 0;
  for (int i = 0; i < 400; ++i) {
    Ray ray;
    ray.origin = {random.uniform(-20, 20), random.uniform(-20, 20), 0.0};
    ray.origin.z() = ground.height(ray.origin.x(), ray.origin.y()) + random.uniform(0.5, 2.5);
    ray.direction = any_direction(random);
    ray.direction.z() = -0.15 * std::abs(ray.direction.z());
    ray.direction.normalize();
    const auto crossing = ground.cross(ray, 50.0);
    if (!crossing) {
      continue;
    }
    ++hits;
    const Vector3d p = ray.origin + crossing->range_m * ray.direction;
    EXPECT_NEAR(p.z(), ground.height(p.x(), p.y()), 1e-6);
    for (double t = 0.05; t < crossing->range_m - 0.05; t += 0.05) {
      const Vector3d q = ray.origin + t * ray.direction;
      ASSERT_GT(q.z(), ground.height(q.x(), q.y()) - 1e-6) << "at " << t;
    }
  }
  EXPECT_GT(hits, 200);
}

TEST(World, TreeFindsWhatTryingAllShapesFinds) {
  const auto scene = make_scene("city", {.seed = 3});
  const World& world = scene->world;
  Random random(2, Stream::kWorld);
  int hits = 0;
  for (int i = 0; i < 3000; ++i) {
    const Pose pose = scene->trajectory.at(random.uniform(0.0, 70.0)).T_world_body;
    Ray ray{pose.translation(), any_direction(random)};
    ray.direction.z() *= 0.2;
    ray.direction.normalize();
    double nearest = 100.0;
    int surface = kNoSurface;
    for (std::size_t k = 0; k < world.shapes().size(); ++k) {
      const auto crossing = cross(ray, world.shapes()[k], k);
      if (crossing && crossing->range_m < nearest) {
        nearest = crossing->range_m;
        surface = static_cast<int>(k);
      }
    }
    if (const auto crossing = world.terrain()->cross(ray, nearest)) {
      nearest = crossing->range_m;
      surface = kGround;
    }
    const Hit hit = world.cast(ray, 100.0);
    ASSERT_EQ(hit.surface, surface);
    if (hit) {
      ++hits;
      ASSERT_EQ(hit.range_m, nearest);
    }
  }
  EXPECT_GT(hits, 1500);
}

TEST(World, EmptyWorldGivesNothing) {
  const World world({}, std::nullopt);
  EXPECT_FALSE(world.cast({Vector3d::Zero(), Vector3d::UnitX()}, 100.0));
}

TEST(SceneBuilder, WallsLeaveTheDoorOpen) {
  SceneBuilder builder;
  // Two rooms of 4 by 4 m and a door of 1 m between them.
  builder.walls_around({{0, 0, 4, 4}, {4.4, 0, 8, 4}, {3.9, 1.5, 4.5, 2.5}}, 3.0, 0.1, 50.0);
  const World world(builder.take(), std::nullopt);
  const auto range = [&](double x, double y, const Vector3d& d) {
    return world.cast({{x, y, 1.0}, d}, 100.0).range_m;
  };
  EXPECT_NEAR(range(2, 2, Vector3d::UnitX()), 6.0, 1e-9);    // through the door to the far wall
  EXPECT_NEAR(range(2, 1, Vector3d::UnitX()), 2.0, 1e-9);    // beside it
  EXPECT_NEAR(range(4.2, 2, Vector3d::UnitY()), 0.5, 1e-9);  // the jamb
  EXPECT_NEAR(range(2, 2, -Vector3d::UnitX()), 2.0, 1e-9);
}

}  // namespace
}  // namespace zloam::simulator
