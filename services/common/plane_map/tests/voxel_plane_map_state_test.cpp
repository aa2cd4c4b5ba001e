#include <gtest/gtest.h>

#include <random>
#include <utility>
#include <vector>

#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {
namespace {

using Eigen::Vector3d;

// Floor and two walls of a room around (0, 0, 0) with normal noise, seen by two rings.
std::vector<Vector3d> room(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> place(-6.0, 6.0);
  std::normal_distribution<double> noise(0.0, 0.01);
  std::vector<Vector3d> points;
  for (int i = 0; i < count; ++i) {
    const double u = place(random);
    const double v = place(random);
    points.emplace_back(u, v, -1.5 + noise(random));
    points.emplace_back(-6.0 + noise(random), u, 0.2 * v);
    points.emplace_back(u, 6.0 + noise(random), 0.2 * v);
  }
  return points;
}

PlaneMapConfig config() {
  PlaneMapConfig c;
  c.settled_points = 200;
  return c;
}

std::vector<SavedVoxel> saved(const VoxelPlaneMap& map) {
  std::vector<SavedVoxel> voxels;
  for (std::size_t i = 0; i < map.roots().size(); ++i) map.save_root(i, voxels);
  return voxels;
}

void expect_same_planes(VoxelPlaneMap& a, VoxelPlaneMap& b) {
  int planes = 0;
  for (const Vector3d& at : room(300, 9)) {
    const auto in_a = a.plane_at(at);
    const auto in_b = b.plane_at(at);
    ASSERT_EQ(in_a.has_value(), in_b.has_value()) << at.transpose();
    if (!in_a) continue;
    ++planes;
    EXPECT_NEAR(std::abs(in_a->normal.dot(in_b->normal)), 1.0, 1e-6);
    EXPECT_NEAR((in_a->centre - in_b->centre).norm(), 0.0, 1e-4);
  }
  EXPECT_GT(planes, 500);
}

TEST(VoxelPlaneMapState, WhatWasSavedGivesTheSamePlanes) {
  VoxelPlaneMap map(config());
  map.insert_points(room(20'000, 1));
  VoxelPlaneMap copy(config());
  for (const SavedVoxel& voxel : saved(map)) ASSERT_TRUE(copy.load(voxel));
  expect_same_planes(map, copy);
  EXPECT_EQ(copy.statistics().voxels, map.statistics().voxels);
}

TEST(VoxelPlaneMapState, CountingGoesOnWhereItWas) {
  // When a plane is fitted again depends on the look-ups. Here it is at the first one after each
  // change.
  PlaneMapConfig always = config();
  always.refit_growth = 1.0;
  always.settled_points = 1'000'000;
  VoxelPlaneMap whole(always);
  whole.insert_points(room(2'000, 1));
  VoxelPlaneMap copy(always);
  for (const SavedVoxel& voxel : saved(whole)) ASSERT_TRUE(copy.load(voxel));
  whole.insert_points(room(2'000, 2));
  copy.insert_points(room(2'000, 2));
  const auto sums = [](const VoxelPlaneMap& map) {
    std::uint64_t points = 0;
    for (const RootSummary& root : map.roots()) points += root.count;
    return points;
  };
  EXPECT_EQ(sums(whole), 12'000U);
  EXPECT_EQ(sums(copy), 12'000U);
  expect_same_planes(whole, copy);
}

TEST(VoxelPlaneMapState, WhichRingsWereSeenGoesAlong) {
  const auto add = [](VoxelPlaneMap& map, unsigned seed) {
    map.set_anchor(Vector3d::Zero());
    std::mt19937 random(seed);
    std::vector<LocalPoint> points;
    for (const Vector3d& at : room(2'000, seed)) {
      const Eigen::Vector3f p = at.cast<float>();
      points.push_back({p.x(), p.y(), p.z(), static_cast<std::uint16_t>(random() % 8 / 3)});
    }
    map.insert(points);
  };
  const auto leads = [](const VoxelPlaneMap& map) {
    std::vector<std::pair<std::uint16_t, std::uint32_t>> out;
    for (const SavedVoxel& voxel : saved(map)) out.emplace_back(voxel.ring, voxel.lead);
    return out;
  };
  PlaneMapConfig never_settled = config();
  never_settled.settled_points = 1'000'000;
  VoxelPlaneMap whole(never_settled);
  add(whole, 1);
  VoxelPlaneMap copy(never_settled);
  for (const SavedVoxel& voxel : saved(whole)) ASSERT_TRUE(copy.load(voxel));
  EXPECT_EQ(leads(copy), leads(whole));
  add(whole, 2);
  add(copy, 2);
  EXPECT_EQ(leads(copy), leads(whole));
}

// As of a sensor that stood for days: counts near the end of 32 bits, and sums in which a sweep
// more can't be told.
TEST(VoxelPlaneMapState, AVoxelThatIsFullTakesNoMore) {
  VoxelPlaneMap map(config());
  map.insert_points(room(20'000, 1));
  std::vector<SavedVoxel> full = saved(map);
  for (SavedVoxel& voxel : full) {
    const std::uint32_t times = 0xffff'ffffU / voxel.count;
    voxel.count *= times;
    voxel.lead *= times;
    for (float& value : voxel.sum) value *= static_cast<float>(times);
    for (float& value : voxel.squares) value *= static_cast<float>(times);
  }
  VoxelPlaneMap before(config()), after(config());
  for (const SavedVoxel& voxel : full) {
    ASSERT_TRUE(before.load(voxel));
    ASSERT_TRUE(after.load(voxel));
  }
  after.insert_points(room(20'000, 2));
  for (std::size_t i = 0; i < before.roots().size(); ++i) {
    std::vector<SavedVoxel> was, is;
    before.save_root(i, was);
    after.save_root(i, is);
    EXPECT_EQ(is.front().count, was.front().count) << i;
    EXPECT_EQ(is.front().sum, was.front().sum) << i;
    EXPECT_EQ(is.front().squares, was.front().squares) << i;
  }
}

TEST(VoxelPlaneMapState, TheRootsSayWhereTheyLie) {
  VoxelPlaneMap map(config());
  const std::vector<Vector3d> one = {{31.3, -17.2, 4.4}};
  map.insert_points(one);
  const auto roots = map.roots();
  ASSERT_EQ(roots.size(), 1U);
  EXPECT_EQ(roots[0].count, 1U);
  const double half_diagonal_m = 0.5 * std::sqrt(3.0) * map.config().root_voxel_m;
  EXPECT_LE((map.root_centre_map(roots[0].index) - one[0]).norm(), half_diagonal_m);
}

TEST(VoxelPlaneMapState, VoxelsThatCannotBeAreRefused) {
  VoxelPlaneMap map(config());
  SavedVoxel voxel;
  voxel.count = 1;
  voxel.level = 6;
  EXPECT_FALSE(map.load(voxel));
  voxel.level = 0;
  voxel.x = 1 << 20;
  EXPECT_FALSE(map.load(voxel));
  voxel.x = 0;
  voxel.count = 0;
  EXPECT_FALSE(map.load(voxel));
  EXPECT_TRUE(map.empty());
}

}  // namespace
}  // namespace zloam::plane_map
