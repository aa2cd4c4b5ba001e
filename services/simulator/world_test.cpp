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
  // The face x' = -1 of the box turned by 30 degrees: its normal is (cos 30, sin 30), so
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
  // Over the near rim, onto the inside of the far wall.
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
  builder.box({10.0, 0.0, -1.0, 1.0, 4.0, 4.0, 0.0});
  Shape shape = builder.take().front();
  shape.density_per_m = 0.7;
  const int rays = 20000;
  int hits = 0;
  double depth = 0.0;
  for (int i = 0; i < rays; ++i) {
    const Ray ray{Vector3d::Zero(), Vector3d::UnitX(), mixed(static_cast<std::uint64_t>(i))};
    if (const auto crossing = cross(ray, shape, 3)) {
      ASSERT_GE(crossing->range_m, 8.0);
      ASSERT_LE(crossing->range_m, 12.0);
      ++hits;
      depth += crossing->range_m - 8.0;
    }
  }
  const double through = std::exp(-0.7 * 4.0);
  EXPECT_NEAR(static_cast<double>(hits) / rays, 1.0 - through, 0.01);
  EXPECT_NEAR(depth / hits, 1.0 / 0.7 - 4.0 * through / (1.0 - through), 0.03);
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
    Ray ray{pose.translation(), any_direction(random), mixed(static_cast<std::uint64_t>(i))};
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
