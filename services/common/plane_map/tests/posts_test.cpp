// Posts: a coarser voxel's line that serves its finest voxels without a fit of their own.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <span>
#include <vector>

#include "common/plane_map/tests/from_rest.hpp"
#include "common/plane_map/tests/grid.hpp"
#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {
namespace {

using Eigen::Vector3d;
using testing::scan;
using testing::Scanner;
using testing::upright_grid;

// Seven points of each ring on the side of an upright post that faces -x, rings 0.31 m apart.
std::vector<LocalPoint> sides_of_a_post(double x, double y, int rings, int sweeps) {
  constexpr double kRadius_m = 0.12;
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 0.02);
  std::vector<LocalPoint> points;
  for (int i = 0; i < 7 * rings * sweeps; ++i) {
    const int ring = i / 7 % rings;
    const double side = (i % 7 - 3) * 0.03;
    const double depth = std::sqrt(kRadius_m * kRadius_m - side * side);
    points.push_back({static_cast<float>(x - depth + noise(random)), static_cast<float>(y + side),
                      static_cast<float>(0.2 + 0.31 * ring), static_cast<std::uint16_t>(ring)});
  }
  return points;
}

VoxelPlaneMap map_of(const std::vector<LocalPoint>& points, double post_width_m) {
  PlaneMapConfig config = upright_grid();
  config.post_width_m = post_width_m;
  VoxelPlaneMap map(config);
  map.insert(points);
  return map;
}

const double kWidth_m = PlaneMapConfig{}.post_width_m;

TEST(Posts, APostEachOfWhoseVoxelsOneRingMetIsALine) {
  const std::vector<LocalPoint> points = sides_of_a_post(1.05, 0.95, 6, 8);
  VoxelPlaneMap without = map_of(points, 0.0);
  EXPECT_EQ(without.find(0.93f, 0.95f, 0.82f).count, 0);

  VoxelPlaneMap map = map_of(points, kWidth_m);
  const Match match = map.find(0.93f, 0.95f, 0.82f);
  ASSERT_EQ(match.count, 2);
  EXPECT_FALSE(match.is_plane);
  // Unconstrained along the post; across it, residuals count in sigmas of the distribution.
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  for (int i = 0; i < match.count; ++i) {
    const Vector3d n(match.rows[i].nx, match.rows[i].ny, match.rows[i].nz);
    information += n * n.transpose();
  }
  const double noise2 = 0.02 * 0.02;
  const double lateral2 = 4.0 * 0.03 * 0.03;  // of -3 to 3 steps
  EXPECT_NEAR(information(1, 1), noise2 / (lateral2 + noise2), 0.02);
  EXPECT_LT(std::abs(information(2, 2)), 1e-3);
}

TEST(Posts, WhatTheVoxelsFacesCutOffIsNone) {
  const auto rows_at = [](double y) {
    VoxelPlaneMap map = map_of(sides_of_a_post(1.05, y, 6, 8), kWidth_m);
    return map.find(0.93f, static_cast<float>(y), 0.82f).count;
  };
  EXPECT_EQ(rows_at(0.75), 2);
  EXPECT_EQ(rows_at(0.25), 0);  // could be a wall that continues in the next voxel
  EXPECT_EQ(rows_at(1.8), 0);
}

TEST(Posts, WhatOneRingSawMostOfIsNone) {
  std::vector<LocalPoint> points = sides_of_a_post(1.05, 0.95, 6, 8);
  for (LocalPoint& point : points) {
    if (point.ring > 1) point.ring = 1;
  }
  VoxelPlaneMap map = map_of(points, kWidth_m);
  EXPECT_EQ(map.find(0.93f, 0.95f, 0.82f).count, 0);
}

// Flat ground, one long wall and thin posts on the other side, which alone constrain the direction
// along the wall. Some posts stand where no voxel contains them whole.
struct Yard {
  double range(const Vector3d& origin, const Vector3d& direction) const {
    double nearest = std::numeric_limits<double>::infinity();
    if (direction.z() < -1e-9) nearest = (-1.6 - origin.z()) / direction.z();
    if (direction.y() > 1e-9) nearest = std::min(nearest, (9.0 - origin.y()) / direction.y());
    for (int i = 0; i < 12; ++i) {
      nearest = std::min(nearest, to_post({2.3 * i - 9.0, -6.0 - i % 3}, origin, direction));
    }
    return nearest;
  }
  static double to_post(const Eigen::Vector2d& at, const Vector3d& origin,
                        const Vector3d& direction) {
    const Eigen::Vector2d from = origin.head<2>() - at;
    const Eigen::Vector2d d = direction.head<2>();
    const double a = d.squaredNorm(), b = from.dot(d), c = from.squaredNorm() - 0.12 * 0.12;
    const double root = b * b - a * c;
    return root < 0.0 || b >= 0.0 ? std::numeric_limits<double>::infinity()
                                  : (-b - std::sqrt(root)) / a;
  }
};

double error_along_the_wall_m(double post_width_m, double crowd_points) {
  PlaneMapConfig config;
  config.post_width_m = post_width_m;
  MatcherConfig matcher;
  matcher.crowd_points = crowd_points;
  return testing::worst_from_rest_m(Yard{}, 0.1, 2.0, 2, config, matcher);
}

TEST(Posts, HoldASensorAlongAWall) {
  // Points counted fully (crowd_points 0), so that only the posts make the difference.
  EXPECT_GT(error_along_the_wall_m(0.0, 0.0), 0.2);
  EXPECT_LT(error_along_the_wall_m(kWidth_m, 0.0), 0.06);
  EXPECT_LT(error_along_the_wall_m(kWidth_m, MatcherConfig{}.crowd_points), 0.06);
}

}  // namespace
}  // namespace zloam::plane_map
