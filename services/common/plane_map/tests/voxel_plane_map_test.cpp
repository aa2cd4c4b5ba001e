#include "common/plane_map/voxel_plane_map.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <span>

#include "common/plane_map/moments.hpp"
#include "common/plane_map/tests/grid.hpp"

namespace zloam::plane_map {
namespace {

using Eigen::Vector3d;
using testing::upright_grid;

// Points on a patch of a plane about a centre, with normal noise.
std::vector<Vector3d> patch(const Vector3d& centre, const Vector3d& normal, double half_m,
                            double noise_m, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> place(-half_m, half_m);
  std::normal_distribution<double> noise(0.0, 1.0);
  const Vector3d u = normal.unitOrthogonal();
  const Vector3d v = normal.cross(u);
  std::vector<Vector3d> points;
  for (int i = 0; i < count; ++i) {
    points.push_back(centre + place(random) * u + place(random) * v +
                     noise_m * noise(random) * normal);
  }
  return points;
}

void insert_one(VoxelPlaneMap& map, const LocalPoint& point) { map.insert(std::span(&point, 1)); }

TEST(Moments, PrincipalAxesOfAGridMatchTheClosedForm) {
  // A 5 x 3 grid of spacing 0.1 in a plane: variances 0.01 * (n^2 - 1) / 12 along its sides.
  MomentSums<double> sums;
  for (int i = 0; i < 5; ++i) {
    for (int k = 0; k < 3; ++k) {
      sums.add(0.1f * static_cast<float>(i), 0.25f, 0.1f * static_cast<float>(k));
    }
  }
  const PrincipalAxes axes = principal_axes(Moments(15, sums));
  EXPECT_NEAR(axes.centre.x(), 0.2, 1e-7);
  EXPECT_NEAR(axes.centre.y(), 0.25, 1e-7);
  EXPECT_NEAR(axes.centre.z(), 0.1, 1e-7);
  EXPECT_NEAR(axes.variances[2], 0.01 * 24.0 / 12.0, 1e-7);
  EXPECT_NEAR(axes.variances[1], 0.01 * 8.0 / 12.0, 1e-7);
  EXPECT_NEAR(std::abs(axes.axes.col(0).y()), 1.0, 1e-9);
}

TEST(Moments, SumsAboutAnotherOriginAddUp) {
  const auto points = patch({0.3, -0.2, 0.1}, Vector3d(1, 2, 3).normalized(), 0.5, 0.01, 60, 3);
  MomentSums<double> all;
  MomentSums<double> first;
  MomentSums<double> second;
  const Eigen::Vector3f offset(0.5f, -0.25f, 0.125f);  // exact in binary
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3f p = points[i].cast<float>();
    all.add(p.x(), p.y(), p.z());
    const Eigen::Vector3f q = p - offset;
    i < 25 ? first.add(p.x(), p.y(), p.z()) : second.add(q.x(), q.y(), q.z());
  }
  Moments joined(25, first);
  joined.add(Moments(35, second), offset.cast<double>());
  const Moments expected(60, all);
  EXPECT_EQ(joined.count, expected.count);
  EXPECT_LT((joined.mean() - expected.mean()).norm(), 1e-6);
  EXPECT_LT((joined.covariance() - expected.covariance()).norm(), 1e-6);
}

TEST(VoxelPlaneMap, FindsThePlaneThatWasPutIn) {
  VoxelPlaneMap map{PlaneMapConfig{}};
  const Vector3d normal = Vector3d(0.2, -0.5, 1.0).normalized();
  const Vector3d centre(120.0, -340.0, 15.0);  // far from the map's origin
  map.insert_points(patch(centre, normal, 1.0, 0.02, 4000, 1));
  const auto plane = map.plane_at(centre);
  ASSERT_TRUE(plane);
  // 20 mm over a patch of about 0.5 m rms and hundreds of points: some mrad, some mm.
  EXPECT_GT(std::abs(plane->normal.dot(normal)), std::cos(0.01));
  EXPECT_LT(std::abs(normal.dot(plane->centre - centre)), 0.006);
}

TEST(VoxelPlaneMap, NoPlaneWhereNothingIsFlat) {
  VoxelPlaneMap map{PlaneMapConfig{}};
  std::mt19937 random(5);
  std::uniform_real_distribution<double> place(-3.0, 3.0);
  std::vector<Vector3d> cloud;
  for (int i = 0; i < 200000; ++i) {
    cloud.emplace_back(place(random), place(random), place(random));
  }
  map.insert_points(cloud);
  int planes = 0;
  for (int i = 0; i < 1000; ++i) {
    planes += map.plane_at({place(random) * 0.8, place(random) * 0.8, place(random) * 0.8}) ? 1 : 0;
  }
  EXPECT_EQ(planes, 0);
}

TEST(VoxelPlaneMap, ASingleNoisyRingIsNoPlane) {
  // A line thickened by noise across and along the beam: planar in the eigenvalues' ratio only.
  VoxelPlaneMap map{PlaneMapConfig{}};
  std::mt19937 random(9);
  std::normal_distribution<double> noise(0.0, 0.02);
  std::vector<Vector3d> line;
  for (int i = 0; i < 400; ++i) {
    line.emplace_back(4.0 + noise(random), -0.5 + 0.0025 * i, 0.3);
  }
  map.insert_points(line);
  for (const Vector3d& p : line) {
    EXPECT_FALSE(map.plane_at(p));
  }
}

// Even without noise, the bent trace of one ring lies in a plane that is no surface.
TEST(VoxelPlaneMap, AnEdgeBentAroundByOneRingIsNoPlane) {
  for (const int rings : {1, 2}) {
    VoxelPlaneMap map(upright_grid());
    map.set_anchor(Vector3d::Zero());
    for (int i = 0; i < 60; ++i) {
      const float along = 0.5f + 0.004f * static_cast<float>(i);
      const auto ring = static_cast<std::uint16_t>(i % rings);
      insert_one(map, {along, 0.55f, 0.7f, ring});
      insert_one(map, {0.5f, along, 0.7f, ring});
    }
    EXPECT_EQ(map.find(0.55f, 0.55f, 0.7f).is_plane, rings > 1);
  }
}

TEST(VoxelPlaneMap, SmallFacesAreFoundBesideABigWall) {
  VoxelPlaneMap map{PlaneMapConfig{}};
  map.insert_points(patch({0, 0, 0}, Vector3d::UnitY(), 2.0, 0.01, 20000, 2));
  // The side of a pilaster, 0.3 m deep, square to the wall.
  map.insert_points(patch({0.4, 0.2, 0.0}, Vector3d::UnitX(), 0.15, 0.01, 2000, 3));
  int faces = 0;
  for (double y = 0.1; y < 0.32; y += 0.02) {
    const auto plane = map.plane_at({0.4, y, 0.0});
    faces += plane && std::abs(plane->normal.x()) > 0.98 ? 1 : 0;
  }
  EXPECT_GE(faces, 8);
}

// The trace of one ring across the floor, along y, and a few points of other rings beside it.
VoxelPlaneMap trace_and_others(const PlaneMapConfig& config, Vector3d others, float noise_x_m,
                               float noise_z_m, int count_of_others) {
  VoxelPlaneMap map(config);
  map.set_anchor(Vector3d::Zero());
  std::mt19937 random(3);
  std::normal_distribution<float> noise;
  std::vector<LocalPoint> points;
  for (int i = 0; i < 200; ++i) {
    const float y = 0.1f + 0.009f * static_cast<float>(i);
    points.push_back({1.0f + noise_x_m * noise(random), y, 0.1f + noise_z_m * noise(random), 3});
  }
  const Eigen::Vector3f at = others.cast<float>();
  for (int i = 0; i < count_of_others; ++i) {
    points.push_back({at.x() + noise_x_m * noise(random), at.y(),
                      at.z() + noise_z_m * noise(random), static_cast<std::uint16_t>(7 + i % 2)});
  }
  map.insert(points);
  return map;
}

TEST(VoxelPlaneMap, ATraceOfOneRingWithAFewPointsOnTheWallBesideItIsNoPlane) {
  const Vector3d on_the_wall(1.1, 1.9, 1.3);
  const auto is_plane = [&](double one_ring_lead, int count_of_others) {
    PlaneMapConfig config = upright_grid();
    config.one_ring_lead = one_ring_lead;
    return trace_and_others(config, on_the_wall, 0.02f, 0.001f, count_of_others)
        .find(1.0f, 1.0f, 0.1f)
        .is_plane;
  };
  EXPECT_FALSE(is_plane(PlaneMapConfig{}.one_ring_lead, 14));
  EXPECT_TRUE(is_plane(PlaneMapConfig{}.one_ring_lead, 100));  // enough points for a real surface
  // Without the rule, the trace counts as a plane.
  EXPECT_TRUE(is_plane(1.0, 14));
}

TEST(VoxelPlaneMap, FloorThatOneRingSeesMostOfIsAPlane) {
  const Vector3d on_the_floor(1.5, 0.6, 0.1);
  VoxelPlaneMap map = trace_and_others(upright_grid(), on_the_floor, 0.02f, 0.003f, 14);
  EXPECT_TRUE(map.find(1.0f, 1.0f, 0.1f).is_plane);
}

TEST(VoxelPlaneMap, WallOnAVoxelFaceIsOnePlaneThankToTheTurnedGrid) {
  const auto wall = patch({0.5, 0.5, 2.0}, Vector3d::UnitZ(), 1.4, 0.02, 30000, 4);
  const auto offset_error = [&](const PlaneMapConfig& config) {
    VoxelPlaneMap map(config);
    map.insert_points(wall);
    double worst = 0.0;
    for (double x = -0.4; x < 1.4; x += 0.1) {
      for (const double z : {1.99, 2.01}) {
        const auto plane = map.plane_at({x, 0.5, z});
        worst = std::max(worst, plane ? std::abs(plane->centre.z() - 2.0) : 1.0);
      }
    }
    return worst;
  };
  EXPECT_LT(offset_error(PlaneMapConfig{}), 0.008);
  // Without the rotated grid: two half-noise planes, 16 mm off on either side.
  EXPECT_GT(offset_error(upright_grid()), 0.012);
}

TEST(VoxelPlaneMap, SettledPlanesDropTheirFinerVoxels) {
  PlaneMapConfig config;
  config.settled_points = 500;
  VoxelPlaneMap settled(config);
  config.settled_points = 1u << 30;
  VoxelPlaneMap kept(config);
  for (VoxelPlaneMap* map : {&settled, &kept}) {
    for (unsigned round = 0; round < 4; ++round) {
      map->insert_points(patch({0, 0, 0}, Vector3d::UnitZ(), 3.0, 0.01, 20000, round));
      for (double x = -2.5; x < 2.6; x += 0.5) {
        for (double y = -2.5; y < 2.6; y += 0.5) {
          EXPECT_TRUE(map->plane_at({x, y, 0}));
        }
      }
    }
  }
  EXPECT_LT(10 * settled.statistics().voxels, kept.statistics().voxels);
}

TEST(VoxelPlaneMap, PlanesLeftBehindDropTheirFinerVoxels) {
  PlaneMapConfig config;
  config.settled_radius_m = 20.0;
  VoxelPlaneMap map(config);
  const auto add = [&map](unsigned seed) {
    map.insert_points(patch({0, 0, 0}, Vector3d::UnitZ(), 3.0, 0.01, 20000, seed));
  };
  const auto planes = [&map] {
    int found = 0;
    for (double x = -2.5; x < 2.6; x += 0.5) {
      for (double y = -2.5; y < 2.6; y += 0.5) found += map.plane_at({x, y, 0}).has_value();
    }
    return found;
  };
  map.leave_behind(map.T_grid_map() * Vector3d(0, 0, 0));
  add(1);
  ASSERT_EQ(planes(), 121);
  const std::size_t near = map.statistics().voxels;
  map.leave_behind(map.T_grid_map() * Vector3d(10, 0, 0));
  EXPECT_EQ(map.statistics().voxels, near);
  map.leave_behind(map.T_grid_map() * Vector3d(30, 0, 0));
  const std::size_t far = map.statistics().voxels;
  EXPECT_LT(2 * far, near);
  EXPECT_EQ(planes(), 121);
  // Points seen again are counted, and create no finer voxels.
  add(2);
  EXPECT_EQ(planes(), 121);
  EXPECT_LT(map.statistics().voxels, far + far / 10);
}

TEST(VoxelPlaneMap, FarVoxelsGoAndNearOnesStay) {
  PlaneMapConfig config;
  config.keep_radius_m = 30.0;
  VoxelPlaneMap map(config);
  map.insert_points(patch({0, 0, 0}, Vector3d::UnitZ(), 1.0, 0.01, 3000, 1));
  map.insert_points(patch({50, 0, 0}, Vector3d::UnitZ(), 1.0, 0.01, 3000, 1));
  const std::size_t before = map.statistics().voxels;
  map.leave_behind(map.T_grid_map() * Vector3d(50, 0, 0));
  EXPECT_FALSE(map.plane_at({0, 0, 0}));
  EXPECT_TRUE(map.plane_at({50, 0, 0}));
  EXPECT_LT(map.statistics().voxels, before);
  // Released memory is reused: the same patch elsewhere takes no new memory.
  const std::size_t bytes = map.statistics().bytes;
  map.insert_points(patch({60, 0, 0}, Vector3d::UnitZ(), 1.0, 0.01, 3000, 1));
  EXPECT_LE(map.statistics().bytes, bytes + 4096);
}

// Points of a cluttered place on both sides of the origin; some have a near neighbour.
std::vector<LocalPoint> clutter(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> place(0.0f, 3.0f);
  std::vector<LocalPoint> points;
  while (points.size() < count) {
    const LocalPoint p{place(random), place(random), place(random),
                       static_cast<std::uint16_t>(random() % 2)};
    points.push_back(p);
    if (random() % 4 == 0) points.push_back({p.x + 0.01f, p.y, p.z - 0.01f, p.ring});
  }
  return points;
}

// Compares a voxel with the sums computed directly from the points.
void expect_counted(const SavedVoxel& voxel, const std::vector<LocalPoint>& points, double edge_m) {
  const Vector3d low = edge_m * Vector3d(voxel.x, voxel.y, voxel.z);
  const Vector3d centre = low.array() + 0.5 * edge_m;
  std::uint32_t count = 0;
  Vector3d sum = Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();
  std::uint32_t of_ring = 0;
  for (const LocalPoint& p : points) {
    const Vector3d at(p.x, p.y, p.z);
    if (((at - low).array() < 0.0).any() || ((at - low).array() >= edge_m).any()) continue;
    ++count;
    sum += at - centre;
    squares += (at - centre) * (at - centre).transpose();
    of_ring += p.ring;
  }
  ASSERT_EQ(voxel.count, count);
  // With two rings, the majority vote is exact: which ring leads, and by how much.
  const std::uint32_t others = count - of_ring;
  EXPECT_EQ(voxel.lead, std::max(of_ring, others) - std::min(of_ring, others));
  EXPECT_TRUE(voxel.lead == 0 || voxel.ring == (of_ring > others ? 1 : 0));
  const double tolerance = 1e-5 * count;
  for (int i = 0, at = 0; i < 3; ++i) {
    EXPECT_NEAR(voxel.sum[static_cast<std::size_t>(i)], sum[i], tolerance);
    for (int j = i; j < 3; ++j, ++at) {
      EXPECT_NEAR(voxel.squares[static_cast<std::size_t>(at)], squares(i, j), tolerance);
    }
  }
}

TEST(VoxelPlaneMap, EveryVoxelHoldsTheSumsOfItsPoints) {
  const PlaneMapConfig config = upright_grid();
  VoxelPlaneMap map(config);
  map.set_anchor(Vector3d::Zero());
  const auto points = clutter(4000, 5);
  map.insert(std::span(points).first(1500));
  map.insert(std::span(points).subspan(1500));
  std::vector<SavedVoxel> voxels;
  for (std::size_t root = 0; root < map.roots().size(); ++root) map.save_root(root, voxels);
  std::array<std::uint32_t, 5> counted{};
  for (const SavedVoxel& voxel : voxels) {
    expect_counted(voxel, points, config.root_voxel_m / (1 << voxel.level));
    counted.at(voxel.level) += voxel.count;
  }
  for (const std::uint32_t of_level : counted) EXPECT_EQ(of_level, points.size());
}

TEST(VoxelPlaneMap, TheFarthestPointsOfTheSmallestVoxelsStayApart) {
  PlaneMapConfig config = upright_grid();
  config.root_voxel_m = 0.1;
  config.levels = 6;
  VoxelPlaneMap map(config);
  map.set_anchor(Vector3d::Zero());
  std::vector<LocalPoint> points;
  for (const float x : {-2999.9f, -0.01f, 2999.9f}) points.push_back({x, -x, x});
  map.insert(points);
  EXPECT_EQ(map.roots().size(), 3U);
}

TEST(VoxelPlaneMap, BadPointsAreIgnored) {
  VoxelPlaneMap map{PlaneMapConfig{}};
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  insert_one(map, {nan, 0, 0});
  insert_one(map, {0, inf, 0});
  insert_one(map, {0, 0, 1e30f});
  EXPECT_TRUE(map.empty());
  EXPECT_EQ(map.find(nan, 0, 0).count, 0);
  EXPECT_EQ(map.find(0, 0, 0).count, 0);
  for (int i = 0; i < 1000; ++i) {
    insert_one(map, {1.0f, 1.0f, 1.0f});
  }
  EXPECT_FALSE(map.find(1.0f, 1.0f, 1.0f).is_plane);  // one place is no plane
}

TEST(VoxelPlaneMap, RefusesAConfigurationOutOfRange) {
  PlaneMapConfig config;
  config.levels = 1;
  EXPECT_THROW(VoxelPlaneMap{config}, std::invalid_argument);
  config = PlaneMapConfig{};
  config.range_noise_m = 0.0;
  EXPECT_THROW(VoxelPlaneMap{config}, std::invalid_argument);
}

}  // namespace
}  // namespace zloam::plane_map
