#include <gtest/gtest.h>

#include "mapping/mapping.hpp"
#include "mapping/test_room.hpp"
#include "mapping/voxel_tiles.hpp"

namespace zloam::mapping {
namespace {

constexpr std::uint32_t kPeriod_ns = 100'000'000;
constexpr int kBefore = 12;

// A slow drive through the room. Each scan is taken at rest, so that it needs no deskewing.
Pose truth(int sweep) {
  Vector6 step;
  step << 0.1, 0.01, 0.0, 0.0, 0.0, 0.02;
  return exp_se3(sweep * step);
}

class Restored : public ::testing::Test {
 protected:
  MappingConfig config() const {
    MappingConfig c;
    // several cubes, on both sides of the origin
    c.tile_edge_m = 5.0;
    return c;
  }

  static MappingInput input_of(const test::Scan& scan, int sweep, const Pose& T_map_odom,
                               std::uint32_t epoch) {
    MappingInput input;
    input.sweep = static_cast<std::uint64_t>(sweep);
    input.stamp_ns = static_cast<std::int64_t>(sweep) * kPeriod_ns;
    input.instant_ns = kPeriod_ns;
    input.period_ns = kPeriod_ns;
    input.odom_epoch = epoch;
    input.T_odom_base = T_map_odom.inverse() * truth(sweep);
    // The scans are of one instant; a twist other than zero tells that the motion is known, which
    // it is from the second sweep on.
    if (sweep > 0) input.twist_per_s.x() = 1e-12;
    input.edges = scan.edges;
    input.planes = scan.planes;
    return input;
  }

  static test::Scan scan_of(const test::Room& room, int sweep) {
    return test::scan(room, truth(sweep), 0.01, 40U + static_cast<unsigned>(sweep));
  }

  static MappingResult feed(Mapper& mapper, const test::Room& room, int sweep,
                            const Pose& T_map_odom, std::uint32_t epoch) {
    const test::Scan scan = scan_of(room, sweep);
    return mapper.process(input_of(scan, sweep, T_map_odom, epoch));
  }

  // What the store has of a killed mapper.
  SavedMap killed(const test::Room& room) const {
    Mapper mapper{config()};
    MappingResult last;
    for (int i = 0; i < kBefore; ++i) last = feed(mapper, room, i, Pose::Identity(), 0);
    SavedMap saved;
    for (const TileId& id : mapper.tiles()) saved.tiles.push_back(*mapper.tile(id));
    saved.voxels = mapper.take_changed_voxels(0.0);
    saved.instant_ns = static_cast<std::int64_t>(kBefore) * kPeriod_ns;
    saved.T_map_base = last.T_map_base;
    saved.T_map_odom = last.T_map_odom;
    return saved;
  }

  static double error_m(const MappingResult& result, int sweep) {
    return (truth(sweep).inverse() * result.T_map_base).translation().norm();
  }
};

TEST_F(Restored, GoesOnInTheSameFrameOfTheOdometry) {
  const test::Room room = test::furnished_room();
  const SavedMap saved = killed(room);
  std::size_t points = 0;
  for (const Tile& tile : saved.tiles) points += tile.points.size();
  Mapper mapper{config()};
  mapper.restore(saved);
  EXPECT_EQ(mapper.point_count(), points);
  for (int i = kBefore + 5; i < kBefore + 15; ++i) {
    const MappingResult result = feed(mapper, room, i, Pose::Identity(), 0);
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_TRUE(result.inserted) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

// The store has the voxels of some sweeps ago, the stream the sweeps inserted since then with the
// state after each: the restored mapper continues as if it had never been killed.
TEST_F(Restored, WithTheStateOfTheInstanceBeforeItIsThatInstance) {
  const test::Room room = test::furnished_room();
  Mapper before{config()};
  for (int i = 0; i < kBefore; ++i) feed(before, room, i, Pose::Identity(), 0);
  SavedMap saved;
  for (const TileId& id : before.tiles()) saved.tiles.push_back(*before.tile(id));
  saved.voxels = before.take_changed_voxels(0.0);
  Mapper after{config()};
  constexpr int kSince = 7;
  std::vector<MappingResult> results;
  std::vector<std::vector<std::uint64_t>> states;
  for (int i = kBefore; i < kBefore + kSince; ++i) {
    results.push_back(feed(before, room, i, Pose::Identity(), 0));
    ASSERT_TRUE(results.back().inserted);
    states.push_back(before.state());
    ASSERT_FALSE(states.back().empty());
  }
  saved.T_map_base = results.back().T_map_base;
  saved.T_map_odom = results.back().T_map_odom;
  after.restore(saved);
  for (int k = 0; k < kSince; ++k) {
    const test::Scan scan = scan_of(room, kBefore + k);
    after.insert_again(input_of(scan, kBefore + k, Pose::Identity(), 0), results[k].T_map_odom,
                       states[k]);
  }
  after.resume(states.back());
  for (int i = kBefore + kSince; i < kBefore + kSince + 10; ++i) {
    const MappingResult one = feed(before, room, i, Pose::Identity(), 0);
    const MappingResult other = feed(after, room, i, Pose::Identity(), 0);
    // Not bit-identical: the planes are refitted at different counts.
    EXPECT_LT((one.T_map_base.inverse() * other.T_map_base).translation().norm(), 1e-3) << i;
    EXPECT_EQ(other.health, Health::kOk);
  }
}

TEST_F(Restored, AStateOfAnotherProgramCountsForNothing) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  mapper.restore(killed(room));
  mapper.resume(std::vector<std::uint64_t>(300, 7));
  for (int i = kBefore + 5; i < kBefore + 15; ++i) {
    const MappingResult result = feed(mapper, room, i, Pose::Identity(), 0);
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

TEST_F(Restored, FindsItselfInANewFrameOfTheOdometry) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  mapper.restore(killed(room));
  // The odometry restarted where the robot was after five more sweeps.
  const Pose T_map_odom = truth(kBefore + 5);
  for (int i = kBefore + 5; i < kBefore + 15; ++i) {
    const MappingResult result = feed(mapper, room, i, T_map_odom, 1);
    // found at once; the frame is settled with its third sweep
    EXPECT_EQ(result.health, i < kBefore + 7 ? Health::kBridging : Health::kOk) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
    EXPECT_LT((T_map_odom.inverse() * result.T_map_odom).translation().norm(), 0.03);
  }
}

// The user has corrected registration.range_noise_m, or localizes with another sensor.
TEST_F(Restored, AMapOfAnotherRangeNoiseIsUsed) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  mapper.restore(killed(room));
  for (int i = kBefore + 5; i < kBefore + 15; ++i) {
    const test::Scan scan = scan_of(room, i);
    MappingInput input = input_of(scan, i, Pose::Identity(), 0);
    input.range_noise_m = 0.03;
    const MappingResult result = mapper.process(input);
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

TEST(VoxelTiles, OnlyCubesOfTheSameVoxelsFit) {
  const plane_map::PlaneMapConfig config;
  VoxelTile cube;
  cube.edge_m = VoxelTiles::kEdge_m;
  cube.root_voxel_m = config.root_voxel_m;
  cube.levels = config.levels;
  cube.range_noise_m = 2.0 * config.range_noise_m;
  EXPECT_TRUE(VoxelTiles::fits(cube, config));
  cube.levels = config.levels - 1;
  EXPECT_FALSE(VoxelTiles::fits(cube, config));
  cube.levels = config.levels;
  cube.root_voxel_m = 0.5 * config.root_voxel_m;
  EXPECT_FALSE(VoxelTiles::fits(cube, config));
}

TEST_F(Restored, AFrameWhosePoseIsUnknownIsSearchedForAroundTheLastPose) {
  const test::Room room = test::furnished_room();
  SavedMap saved = killed(room);
  saved.T_map_odom.reset();
  Mapper mapper{config()};
  mapper.restore(saved);
  const Pose T_map_odom = truth(kBefore + 5);
  for (int i = kBefore + 5; i < kBefore + 10; ++i) {
    const MappingResult result = feed(mapper, room, i, T_map_odom, 0);
    // found at once; the frame is settled with its third sweep
    EXPECT_EQ(result.health, i < kBefore + 7 ? Health::kBridging : Health::kOk) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

// An empty first sweep, such as the partial revolution with which a driver starts.
TEST_F(Restored, ASweepWithoutPointsIsNotYetFound) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  mapper.restore(killed(room));
  const Pose T_map_odom = truth(kBefore + 5);
  MappingInput nothing;
  nothing.sweep = static_cast<std::uint64_t>(kBefore + 5);
  nothing.stamp_ns = static_cast<std::int64_t>(kBefore + 5) * kPeriod_ns;
  nothing.instant_ns = nothing.period_ns = kPeriod_ns;
  nothing.odom_epoch = 1;
  EXPECT_EQ(mapper.process(nothing).health, Health::kBridging);
  const MappingResult result = feed(mapper, room, kBefore + 6, T_map_odom, 1);
  EXPECT_LT(error_m(result, kBefore + 6), 0.03);
}

TEST_F(Restored, SomewhereElseItSaysLostAndInsertsNothing) {
  MappingConfig c = config();
  c.bridge_sweeps = 3;
  Mapper mapper{c};
  mapper.restore(killed(test::furnished_room()));
  const std::size_t points = mapper.point_count();
  // Walls, floor and ceiling are all displaced by more than the search reaches.
  const test::Room elsewhere = {{{-40.0, -31.0, -5.3}, {37.0, 29.0, 9.7}},
                                {{{12.0, -9.0, -5.3}, {19.0, -2.0, 9.7}}}};
  for (int i = kBefore + 5; i < kBefore + 12; ++i) {
    const MappingResult result = feed(mapper, elsewhere, i, Pose::Identity(), 0);
    EXPECT_FALSE(result.inserted);
    EXPECT_EQ(result.health, i < kBefore + 8 ? Health::kBridging : Health::kLost) << i;
  }
  EXPECT_EQ(mapper.point_count(), points);
  EXPECT_TRUE(mapper.take_changed_voxels(0.0).empty());
}

// A robot is carried unobserved by its odometry, rotated by 3 rad, so that the room's walls look
// alike, and set down elsewhere.
constexpr int kSetDown = kBefore + 15;
Pose frame_after_carrying() {
  const Pose turned(Eigen::AngleAxisd(3.0, Eigen::Vector3d::UnitZ()));
  return truth(kSetDown) * turned.inverse() * truth(kBefore).inverse();
}

TEST_F(Restored, ACarriedRobotIsFoundByWhatStandsInTheRoom) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  for (int i = 0; i < kBefore; ++i) feed(mapper, room, i, Pose::Identity(), 0);
  for (int i = kSetDown; i < kSetDown + 8; ++i) {
    const MappingResult result = feed(mapper, room, i, frame_after_carrying(), 0);
    // three sweeps must agree
    EXPECT_EQ(result.health, i < kSetDown + 2 ? Health::kLost : Health::kOk) << result.reason;
    if (result.health != Health::kOk) continue;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

// Rotates a pose by 180 degrees about the centre of the furnished room's hull.
Pose from_the_other_end(const Pose& T_map_base) {
  const Pose middle(Eigen::Translation3d(2.0, 1.0, 0.0));
  const Pose turned(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()));
  return middle * turned * middle.inverse() * T_map_base;
}

Pose roughly(Pose T_map_base) {
  T_map_base.translation() += Eigen::Vector3d(0.8, -0.6, 0.0);
  T_map_base.linear() = T_map_base.linear() * Eigen::AngleAxisd(0.12, Eigen::Vector3d::UnitZ());
  return T_map_base;
}

TEST_F(Restored, InARoomThatIsTheSameFromItsOtherEndSomebodyMustSayWhereTheRobotIs) {
  test::Room room = test::furnished_room();
  room.boxes.clear();
  Mapper mapper{config()};
  for (int i = 0; i < kBefore; ++i) feed(mapper, room, i, Pose::Identity(), 0);
  int i = kSetDown;
  for (const bool right : {false, true}) {
    const auto wanted = [&](int at) { return right ? truth(at) : from_the_other_end(truth(at)); };
    mapper.place(roughly(wanted(i)));
    for (const int placed = i; i < placed + 7; ++i) {
      const MappingResult result = feed(mapper, room, i, frame_after_carrying(), 0);
      if (i < placed + 4) continue;
      EXPECT_EQ(result.health, Health::kOk) << result.reason;
      EXPECT_LT((result.T_map_base.inverse() * wanted(i)).translation().norm(), 0.1) << i;
    }
  }
}

TEST_F(Restored, AWrongPlaceIsNotTakenForTheRobots) {
  const test::Room room = test::furnished_room();
  Mapper mapper{config()};
  for (int i = 0; i < kBefore; ++i) feed(mapper, room, i, Pose::Identity(), 0);
  const std::size_t points = mapper.point_count();
  Pose said = truth(kBefore);
  said.linear() = said.linear() * Eigen::AngleAxisd(2.0, Eigen::Vector3d::UnitZ());
  mapper.place(said);
  for (int i = kBefore; i < kBefore + 3; ++i) {
    EXPECT_NE(feed(mapper, room, i, Pose::Identity(), 0).health, Health::kOk);
  }
  EXPECT_EQ(mapper.point_count(), points);
}

TEST_F(Restored, WithoutAMapANewOneIsFoundedInTheSameFrame) {
  SavedMap saved;
  saved.T_map_base = truth(kBefore);
  saved.T_map_odom = truth(3);
  saved.instant_ns = static_cast<std::int64_t>(kBefore) * kPeriod_ns;
  Mapper mapper{config()};
  mapper.restore(saved);
  const test::Room room = test::furnished_room();
  for (int i = kBefore + 5; i < kBefore + 12; ++i) {
    const MappingResult result = feed(mapper, room, i, truth(3), 0);
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_LT(error_m(result, i), 0.03) << i;
  }
}

TEST_F(Restored, TheVersionsOfTheCubesGoOn) {
  const test::Room room = test::furnished_room();
  const SavedMap saved = killed(room);
  Mapper mapper{config()};
  mapper.restore(saved);
  const MappingResult result = feed(mapper, room, kBefore, Pose::Identity(), 0);
  ASSERT_TRUE(result.inserted) << result.reason;
  ASSERT_FALSE(result.changed.empty());
  for (const TileId& id : result.changed) {
    std::uint64_t before = 0;
    for (const Tile& tile : saved.tiles) before = tile.id == id ? tile.version : before;
    EXPECT_GT(mapper.tile(id)->version, before);
  }
  int compared = 0;
  for (const VoxelTile& tile : mapper.take_changed_voxels(0.0)) {
    for (const VoxelTile& old : saved.voxels) {
      if (old.index == tile.index) {
        EXPECT_GT(tile.version, old.version);
        ++compared;
      }
    }
  }
  // The sweep is of the same room.
  EXPECT_GT(compared, 0);
}

TEST(VoxelTiles, ACubeIsHandedOutWhenItHasGrownEnough) {
  plane_map::VoxelPlaneMap map{plane_map::PlaneMapConfig()};
  const auto count = [&map](double x_m, int points) {
    map.insert_points(std::vector<Eigen::Vector3d>(static_cast<std::size_t>(points),
                                                   Eigen::Vector3d(x_m, 1.0, 1.0)));
  };
  const auto points_of = [](const VoxelTile& tile) {
    std::uint32_t sum = 0;
    for (const auto& voxel : tile.voxels) sum += voxel.level == 0 ? voxel.count : 0;
    return sum;
  };
  VoxelTiles tiles;
  count(1.0, 100);
  count(31.0, 100);
  ASSERT_EQ(tiles.take_changed(map, 0.25).size(), 2U);
  count(1.0, 25);
  EXPECT_TRUE(tiles.take_changed(map, 0.25).empty()) << "no more than the share";
  count(1.0, 1);
  const auto grown = tiles.take_changed(map, 0.25);
  ASSERT_EQ(grown.size(), 1U);
  EXPECT_EQ(grown[0].version, 2U);
  EXPECT_EQ(points_of(grown[0]), 126U) << "whole, with what was held back";
  count(31.0, 1);
  const auto changed = tiles.take_changed(map, 0.0);
  ASSERT_EQ(changed.size(), 1U);
  EXPECT_EQ(points_of(changed[0]), 101U);
}

// The end of a loop: the voxels at its start were dropped on the way, and begin again.
TEST(VoxelTiles, ACubeSeenAgainDoesNotReplaceOneWithMorePoints) {
  plane_map::VoxelPlaneMap map{plane_map::PlaneMapConfig()};
  const auto count = [&map](int points) {
    map.insert_points(std::vector<Eigen::Vector3d>(static_cast<std::size_t>(points),
                                                   Eigen::Vector3d(1.0, 1.0, 1.0)));
  };
  VoxelTiles tiles;
  count(100);
  ASSERT_EQ(tiles.take_changed(map, 0.0).size(), 1U);
  map.leave_behind(map.T_grid_map() * Eigen::Vector3d(400.0, 0.0, 0.0));
  ASSERT_TRUE(map.empty());
  count(10);
  EXPECT_TRUE(tiles.take_changed(map, 0.0).empty());
  count(20);
  EXPECT_TRUE(tiles.take_changed(map, 0.0).empty());
  count(80);
  const auto more = tiles.take_changed(map, 0.0);
  ASSERT_EQ(more.size(), 1U);
  EXPECT_EQ(more[0].version, 2U);
}

}  // namespace
}  // namespace zloam::mapping
