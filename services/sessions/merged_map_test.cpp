// The voxels of a wall, a post and a car, counted again after a motion: what is known of them is
// compared with the wall, the post and the motion.

#include "sessions/merged_map.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace zloam::sessions {
namespace {

using plane_map::PlaneMapConfig;
using plane_map::SavedVoxel;
using plane_map::VoxelPlaneMap;

const PlaneMapConfig kMap;
constexpr std::size_t kMany = 1'000'000;
const MapSizes kSizes{50.0, kMap.root_voxel_m, kMap.levels, kMap.range_noise_m};

/// A wall along x at y = 3, and a car in front of it, with 2 cm of noise across.
std::vector<Eigen::Vector3d> side(double y_m, double from_m, double to_m, double high_m) {
  std::mt19937_64 random(static_cast<std::uint64_t>(100.0 * y_m));
  std::normal_distribution<double> noise(0.0, 0.02);
  std::vector<Eigen::Vector3d> points;
  for (double x = from_m; x < to_m; x += 0.05) {
    for (double z = 0.0; z < high_m; z += 0.1) points.emplace_back(x, y_m + noise(random), z);
  }
  return points;
}

std::vector<Eigen::Vector3d> wall() { return side(3.0, -4.0, 4.0, 3.0); }
std::vector<Eigen::Vector3d> car() { return side(1.0, -1.0, 3.0, 1.4); }

/// Where the map lies in the merged one: turned and shifted by no multiple of a voxel.
Pose moved() {
  Pose T_world_map = Pose::Identity();
  T_world_map.linear() = (Eigen::AngleAxisd(0.5, Eigen::Vector3d::UnitZ()) *
                          Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitX()))
                             .toRotationMatrix();
  T_world_map.translation() << 31.7, -12.3, 0.9;
  return T_world_map;
}

Submap seen(const std::vector<Eigen::Vector3d>& points_map) {
  Submap submap;
  for (const Eigen::Vector3d& p : points_map) {
    const Eigen::Vector3f at = p.cast<float>();
    submap.points.push_back({at.x(), at.y(), at.z(), 1.0F});
  }
  return submap;
}

void add_place(SeenPlaces& places, const std::vector<Eigen::Vector3d>& points_map, bool moving,
               std::size_t number) {
  places.add(seen(points_map), std::vector<bool>(points_map.size(), moving), number);
}

std::vector<mapping::Tile> tiles_of(const std::vector<Eigen::Vector3d>& points_map) {
  mapping::Tile tile{{{0, 0, 0}, Layer::kEdge}, kSizes.tile_edge_m, 1, {}, {}};
  tile.points = seen(points_map).points;
  tile.counts.assign(points_map.size(), 3);
  return {tile};
}

/// The wall and the car, of which the car moved, in the merged map.
struct Street {
  std::vector<mapping::Tile> tiles;
  std::vector<mapping::VoxelTile> voxels;
};

Street merged_street() {
  std::vector<Eigen::Vector3d> all = wall();
  for (const Eigen::Vector3d& p : car()) all.push_back(p);
  VoxelPlaneMap map{kMap};
  map.insert_points(all);
  const auto cubes = mapping::VoxelTiles().take_changed(map, 0.0);
  const auto tiles = tiles_of(all);
  SeenPlaces places;
  add_place(places, wall(), false, 0);
  add_place(places, car(), true, 1);
  const MapPart part{tiles, cubes, places, {moved(), moved()}};
  MapBuilder builder(kSizes);
  builder.add_voxels(part, MapBuilder::Half::kFirst);
  builder.add_voxels(part, MapBuilder::Half::kSecond);
  builder.add_points(std::vector{part}, kMany);
  return {builder.tiles(), builder.voxels()};
}

VoxelPlaneMap loaded(const std::vector<mapping::VoxelTile>& cubes) {
  mapping::VoxelTiles tiles;
  tiles.keep_for_loading(cubes);
  VoxelPlaneMap map{kMap};
  tiles.load_into(map);
  return map;
}

TEST(MergedMap, AWallIsWhereTheMotionPutsItAndTheCarIsGone) {
  VoxelPlaneMap map = loaded(merged_street().voxels);
  std::size_t found = 0, looked = 0;
  for (double x = -3.5; x < 3.6; x += 0.1) {
    for (double z = 0.3; z < 2.8; z += 0.1) {
      const Eigen::Vector3d at = moved() * Eigen::Vector3d(x, 3.0, z);
      const auto plane = map.plane_at(at);
      ++looked;
      if (!plane) continue;
      ++found;
      EXPECT_LT(std::abs(plane->normal.dot(at - plane->centre)), 0.015);
      const Eigen::Vector3d across = moved().linear() * Eigen::Vector3d::UnitY();
      EXPECT_GT(std::abs(plane->normal.dot(across)), 0.98);
    }
  }
  EXPECT_GT(static_cast<double>(found), 0.97 * static_cast<double>(looked));
  for (double x = -0.5; x < 2.6; x += 0.1) {
    // A coarse voxel with a part of the wall may reach here.
    const Eigen::Vector3d at = moved() * Eigen::Vector3d(x, 1.0, 0.7);
    const auto plane = map.plane_at(at);
    if (!plane) continue;
    EXPECT_GT(std::abs(plane->normal.dot(at - plane->centre)), 1.5) << x;
  }
}

TEST(MergedMap, PointsKeepLayerIntensityAndCount) {
  std::size_t points = 0, counted = 0;
  for (const mapping::Tile& tile : merged_street().tiles) {
    EXPECT_EQ(tile.id.layer, Layer::kEdge);
    EXPECT_EQ(tile.edge_m, kSizes.tile_edge_m);
    for (std::size_t i = 0; i < tile.points.size(); ++i) {
      const MapPoint& p = tile.points[i];
      EXPECT_NEAR((moved().inverse() * Eigen::Vector3d(p.x, p.y, p.z)).y(), 3.0, 0.1);
      EXPECT_EQ(p.intensity, 1.0F);
      counted += tile.counts[i];
      ++points;
    }
  }
  EXPECT_GT(points, wall().size() / 3);
  EXPECT_EQ(counted, 3 * wall().size());
}

// As in a hall of which many maps are merged: a larger message would not be taken.
TEST(MergedMap, PointsAreJoinedUntilACubeCanHaveThem) {
  const auto tiles = tiles_of(wall());
  const std::vector<mapping::VoxelTile> none;
  SeenPlaces places;
  add_place(places, wall(), false, 0);
  MapBuilder builder(kSizes);
  builder.add_points(std::vector{MapPart{tiles, none, places, {moved()}}}, 500);
  std::size_t points = 0, counted = 0;
  for (const mapping::Tile& tile : builder.tiles()) {
    EXPECT_LE(tile.points.size(), 500U);
    points += tile.points.size();
    for (const std::uint32_t count : tile.counts) counted += count;
  }
  EXPECT_GT(points, 100U);
  EXPECT_EQ(counted, 3 * wall().size());
}

TEST(MergedMap, APointFarFromTheOriginIsInIt) {
  const std::vector<Eigen::Vector3d> far = {{150'010.0, 10.0, 10.0}};
  const auto tiles = tiles_of(far);
  const std::vector<mapping::VoxelTile> none;
  SeenPlaces places;
  add_place(places, far, false, 0);
  MapBuilder builder(kSizes);
  builder.add_points(std::vector{MapPart{tiles, none, places, {Pose::Identity()}}}, kMany);
  const auto merged = builder.tiles();
  ASSERT_EQ(merged.size(), 1U);
  EXPECT_EQ(merged[0].id.index.i, 3000);
  EXPECT_EQ(merged[0].points.size(), 1U);
}

/// All sums of one cube, in its coarsest voxel.
plane_map::Moments sums(const std::vector<Patch>& patches) {
  UnitClouds clouds;
  plane_map::MomentSums<double> all;
  unsigned count = 0;
  for (const Patch& patch : patches) {
    for (const Eigen::Vector3d& unit : clouds.of(patch.count)) {
      const Eigen::Vector3f p = (patch.mean + patch.spread * unit).cast<float>();
      all.add(p.x(), p.y(), p.z());
      ++count;
    }
  }
  return {count, all};
}

TEST(DrawnPoints, HaveTheSumsOfTheVoxels) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> spread(0.0, 0.4);
  std::vector<Eigen::Vector3d> points = wall();
  for (int i = 0; i < 500; ++i) {
    points.emplace_back(1.0 + spread(random), 2.5 + spread(random), 2.0 + spread(random));
  }
  VoxelPlaneMap map{kMap};
  map.insert_points(points);
  for (std::size_t root = 0; root < map.roots().size(); ++root) {
    std::vector<SavedVoxel> voxels;
    map.save_root(root, voxels);
    const SavedVoxel& all = voxels.front();
    const plane_map::Moments drawn = sums(patches_of(voxels, kMap.root_voxel_m));
    ASSERT_EQ(drawn.count, all.count);
    const Eigen::Vector3d centre =
        (Eigen::Vector3d(all.x, all.y, all.z).array() + 0.5).matrix() * kMap.root_voxel_m;
    const plane_map::Moments told(all.count, plane_map::MomentSums<float>{all.sum, all.squares});
    EXPECT_LT((drawn.mean() - centre - told.mean()).norm(), 1e-5);
    EXPECT_LT((drawn.covariance() - told.covariance()).norm(), 1e-4);
  }
}

// A settled plane has counted on without its finer voxels.
TEST(DrawnPoints, OfAVoxelAreThoseThatItsChildrenLack) {
  SavedVoxel root;
  root.count = 30;
  root.ring = 7;
  root.lead = 12;
  root.sum = {3.0F, 0.0F, 0.0F};
  root.squares = {10.0F, 0.0F, 0.0F, 10.0F, 0.0F, 0.1F};
  SavedVoxel child;
  child.level = 1;
  child.count = 30;
  EXPECT_EQ(patches_of(std::vector{root}, 2.0).size(), 1U);
  EXPECT_EQ(patches_of(std::vector{root, child}, 2.0).size(), 1U);
  child.count = 10;
  const auto both = patches_of(std::vector{root, child}, 2.0);
  ASSERT_EQ(both.size(), 2U);
  EXPECT_EQ(both[0].count, 20U);
  EXPECT_EQ(both[0].ring, 7);
  EXPECT_EQ(both[0].lead, 12U);
}

TEST(DrawnPoints, AreSpreadWithMeanZeroAndUnitCovariance) {
  UnitClouds clouds;
  for (const std::uint32_t count : {1U, 2U, 3U, 4U, 5U, 8U, 100U, 1000U}) {
    const auto& cloud = clouds.of(count);
    ASSERT_EQ(cloud.size(), count);
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const Eigen::Vector3d& p : cloud) {
      mean += p / count;
      covariance += p * p.transpose() / count;
      EXPECT_LT(p.cwiseAbs().maxCoeff(), 3.0) << count;
    }
    Eigen::Matrix3d expected = Eigen::Matrix3d::Zero();
    for (std::uint32_t axis = 0; axis < std::min(3U, count - 1); ++axis) {
      expected(2 - axis, 2 - axis) = 1.0;
    }
    EXPECT_LT(mean.norm(), 1e-12) << count;
    EXPECT_LT((covariance - expected).norm(), 1e-9) << count;
  }
}

TEST(SeenPlaces, TheFirstSubmapThatSawItCounts) {
  SeenPlaces places;
  add_place(places, {{10.0, 0.0, 0.0}}, true, 0);
  add_place(places, {{10.0, 0.0, 0.0}, {10.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}, false, 1);
  add_place(places, {{0.0, 0.0, 0.0}, {5.0, 0.0, 0.0}}, false, 2);
  add_place(places, {{5.0, 0.0, 0.0}, {5.0, 0.0, 0.0}, {20.0, 0.0, 0.0}}, true, 3);
  EXPECT_EQ(places.standing_at({0.0, 0.0, 0.0}), 1U);
  EXPECT_EQ(places.standing_at({10.0, 0.1, 0.0}), 1U);
  EXPECT_EQ(places.standing_at({0.0, 0.8, 0.0}), 1U);
  EXPECT_FALSE(places.standing_at({0.0, 2.0, 0.0}));
  EXPECT_FALSE(places.standing_at({5.0, 0.0, 0.0}));
  EXPECT_FALSE(places.standing_at({20.0, 0.0, 0.3}));
}

}  // namespace
}  // namespace zloam::sessions
