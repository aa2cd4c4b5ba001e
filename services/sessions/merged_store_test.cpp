// Two drives through one simulated town, each in a map of its own, merged into a folder: what is
// read back from it is compared with the town.

#include "sessions/merged_store.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <iterator>

#include "common/geometry/test_folder.hpp"
#include "common/messages/convert.hpp"
#include "common/messages/keys.hpp"
#include "common/messages/verify.hpp"
#include "graph/test_town.hpp"
#include "mapping/io/tile_messages.hpp"
#include "mapping/tile_map.hpp"
#include "store/tile_store.hpp"

namespace zloam::sessions {
namespace {

namespace fs = std::filesystem;
using graph::TestDrive;
using graph::TestTown;
using graph::Wall;

constexpr std::int64_t kDay_ns = 86'400'000'000'000;
constexpr std::uint64_t kMonday = 11, kTuesday = 22;

std::vector<Pose> part_of_round(std::size_t from, std::size_t count) {
  const std::vector<Pose> round = graph::rounds(70.0, 1);
  return {round.begin() + static_cast<std::ptrdiff_t>(from),
          round.begin() + static_cast<std::ptrdiff_t>(from + count)};
}

// The drives share ten of the round's 43 places; what one sees from its other end is out of the
// other's sight.
constexpr std::size_t kCount = 22, kMondayBegins = 0, kTuesdayBegins = 12;

/// Cubes of a mapping that saw from each place what the submap there holds.
void add_cubes(SavedMap& map) {
  plane_map::VoxelPlaneMap planes{plane_map::PlaneMapConfig{}};
  mapping::TileMap tiles{mapping::MappingConfig{}};
  for (const Submap& submap : map.submaps) {
    std::vector<Eigen::Vector3d> points_map;
    PointVector points;
    for (const MapPoint& p : submap.points) {
      points_map.push_back(submap.T_map_submap * Eigen::Vector3d(p.x, p.y, p.z));
      points.push_back({p.x, p.y, p.z, p.intensity, 0, 0, ReturnType::kStrongest, 0});
    }
    planes.insert_points(points_map);
    tiles.insert(Layer::kPlane, points, submap.T_map_submap);
  }
  map.voxels = mapping::VoxelTiles().take_changed(planes, 0.0);
  for (const mapping::TileId& id : tiles.tiles()) map.tiles.push_back(tiles.tile(id).value());
}

/// The map of a run that drove there: its origin is the first pose.
SavedMap saved(const TestDrive& driven, std::uint64_t run, std::int64_t begin_ns) {
  SavedMap map;
  map.robot = "robot";
  map.run = run;
  const Pose T_map_told = driven.submaps.front().T_map_submap.inverse();
  for (Submap submap : driven.submaps) {
    submap.T_map_submap = T_map_told * submap.T_map_submap;
    submap.instant_ns += begin_ns;
    HeaderFields header;
    header.robot = map.robot;
    header.run = header.map_id = run;
    header.sweep = submap.last_sweep;
    header.frame = "base_link";
    header.instance = "mapping-1";
    map.submaps.push_back(std::move(submap));
    map.headers.push_back(header);
  }
  for (std::size_t i = 0; i < map.submaps.size(); ++i) {
    const Submap& submap = map.submaps[i];
    map.places.add(submap, std::vector<bool>(submap.points.size(), false), i);
  }
  add_cubes(map);
  const Submap& last = map.submaps.back();
  map.last_pose = {last.instant_ns + 1, last.T_map_submap};
  return map;
}

Merged merged(std::vector<SavedMap> maps) {
  Merged out{std::move(maps), graph::LoopGraph(graph::GraphConfig{})};
  for (std::size_t session = 0; session < out.maps.size(); ++session) {
    for (const Submap& submap : out.maps[session].submaps) out.graph.add(submap, session);
  }
  return out;
}

/// The map in a folder, as mapping reads it.
mapping::SavedMap read_cubes(const fs::path& folder) {
  const store::TileStore store(folder, store::StoreLimits{}, store::Access::kRead);
  mapping::SavedMap out;
  for (const std::string& key : store.keys()) {
    const auto message = store.get(key);
    if (!verify<msg::MapTile>(message->payload, message->encoding).ok()) continue;
    add_tile(message_of<msg::MapTile>(message->payload), out);
  }
  return out;
}

std::string bytes_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

double distance_m(const Wall& wall, const Eigen::Vector3d& at) {
  const Eigen::Vector2d along = wall.to - wall.from;
  const double s =
      std::clamp((at.head<2>() - wall.from).dot(along) / along.squaredNorm(), 0.0, 1.0);
  const double beside_m = (wall.from + s * along - at.head<2>()).norm();
  return std::hypot(beside_m, std::max(0.0, at.z() - wall.height_m));
}

class MergedStore : public InFolder {
 protected:
  MergedStore()
      : town_(3),
        monday_(graph::drive(town_, part_of_round(kMondayBegins, kCount), 0.0, 0.0, 1)),
        tuesday_(graph::drive(town_, part_of_round(kTuesdayBegins, kCount), 0.0, 0.0, 2)),
        found_(merged({saved(monday_, kMonday, kDay_ns), saved(tuesday_, kTuesday, 2 * kDay_ns)})),
        map_(folder_ / "week") {}

  /// Distance of a point of the merged map from the nearest surface of the town.
  double error_m(const Eigen::Vector3d& at_map) const {
    const Eigen::Vector3d at = monday_.truth.front() * at_map;
    double nearest = std::abs(at.z());
    for (const Wall& wall : town_.walls()) nearest = std::min(nearest, distance_m(wall, at));
    return nearest;
  }

  TestTown town_;
  TestDrive monday_, tuesday_;
  Merged found_;
  fs::path map_;
};

/// Share of the values below a limit.
double share_below(const std::vector<double>& values, double limit) {
  const auto below = std::ranges::count_if(values, [&](double v) { return v < limit; });
  return static_cast<double>(below) / static_cast<double>(values.size());
}

double median(std::vector<double> values) {
  std::ranges::nth_element(values, values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2));
  return values[values.size() / 2];
}

TEST_F(MergedStore, ItsPointsLieOnTheTown) {
  ASSERT_TRUE(found_.is_joined(1));
  ASSERT_EQ(write_store(found_, map_), "");
  std::vector<double> errors;
  for (const mapping::Tile& tile : read_cubes(map_).tiles) {
    for (const MapPoint& p : tile.points) errors.push_back(error_m({p.x, p.y, p.z}));
  }
  ASSERT_GT(errors.size(), 50'000U);
  // 1 cm of noise, and the mean of two surfaces that meet in a voxel.
  EXPECT_LT(median(errors), 0.01);
  EXPECT_GT(share_below(errors, 0.04), 0.95);
}

// Walls seen by one drive only, by both, and by the other one only; planes are looked up as by a
// matcher.
TEST_F(MergedStore, ItsPlanesAreTheTownsWhereEitherDriveWas) {
  ASSERT_TRUE(found_.is_joined(1));
  ASSERT_EQ(write_store(found_, map_), "");
  mapping::VoxelTiles cubes;
  cubes.keep_for_loading(read_cubes(map_).voxels);
  plane_map::VoxelPlaneMap planes{plane_map::PlaneMapConfig{}};
  cubes.load_into(planes);
  const Pose T_map_town = monday_.truth.front().inverse();
  for (const Pose& seen_from : {monday_.truth[3], monday_.truth[17], tuesday_.truth[18]}) {
    std::vector<double> errors_m;
    std::size_t looked = 0;
    for (const Wall& wall : town_.walls()) {
      const Eigen::Vector2d middle = 0.5 * (wall.from + wall.to);
      if ((middle - seen_from.translation().head<2>()).norm() > 25.0) continue;
      if (wall.height_m < 2.0 || (wall.to - wall.from).norm() < 3.0) continue;
      ++looked;
      const Eigen::Vector3d at = T_map_town * Eigen::Vector3d(middle.x(), middle.y(), 1.5);
      const auto plane = planes.plane_at(at);
      if (plane) errors_m.push_back(std::abs(plane->normal.dot(at - plane->centre)));
    }
    ASSERT_GT(looked, 4U);
    EXPECT_GT(static_cast<double>(errors_m.size()), 0.8 * static_cast<double>(looked));
    EXPECT_LT(median(errors_m), 0.02);
    EXPECT_GT(share_below(errors_m, 0.05), 0.8);
  }
}

TEST_F(MergedStore, TheSameMapsGiveTheSameBytes) {
  ASSERT_EQ(write_store(found_, map_), "");
  const Merged again =
      merged({saved(monday_, kMonday, kDay_ns), saved(tuesday_, kTuesday, 2 * kDay_ns)});
  ASSERT_EQ(write_store(again, folder_ / "again"), "");
  const std::string bytes = bytes_of(map_ / "00000001.log");
  EXPECT_GT(bytes.size(), 1'000'000U);
  EXPECT_TRUE(bytes == bytes_of(folder_ / "again" / "00000001.log"));
}

TEST_F(MergedStore, ItIsReadAndMergedLikeAMapOfARun) {
  ASSERT_EQ(write_store(found_, map_), "");
  const SavedMap week = read_saved_map(map_);
  EXPECT_FALSE(week.damaged);
  EXPECT_EQ(week.robot, "robot");
  ASSERT_EQ(week.submaps.size(), 2 * kCount);
  for (std::size_t i = 0; i < 2 * kCount; ++i) {
    const Pose& truth = i < kCount ? monday_.truth[i] : tuesday_.truth[i - kCount];
    const Pose T_map_submap = monday_.truth.front().inverse() * truth;
    const Pose off = T_map_submap.inverse() * week.submaps[i].T_map_submap;
    EXPECT_LT(off.translation().norm(), 0.05) << i;
  }
  // The robot stands where the newest drive ended.
  ASSERT_TRUE(week.last_pose);
  EXPECT_EQ(week.last_pose->instant_ns, found_.maps[1].last_pose->instant_ns);
  EXPECT_LT(
      (week.last_pose->T_map_base.translation() - week.submaps.back().T_map_submap.translation())
          .norm(),
      0.01);
  ASSERT_TRUE(sizes_of(week));
  EXPECT_EQ(sizes_of(week)->levels, plane_map::PlaneMapConfig{}.levels);
  EXPECT_EQ(common_run(week, found_.maps[0]), kMonday);
  EXPECT_EQ(common_run(week, found_.maps[1]), kTuesday);
  const TestDrive wednesday = graph::drive(town_, part_of_round(20, 14), 0.0, 0.0, 3);
  const Merged more = merged({week, saved(wednesday, 33, 3 * kDay_ns)});
  EXPECT_FALSE(common_run(more.maps[0], more.maps[1]));
  EXPECT_TRUE(more.is_joined(1));
}

// Two robots of one fleet, or two simulated drives, may have closed submaps at the same time.
TEST_F(MergedStore, DrivesOfTheSameTimeStayApart) {
  const Merged both = merged({saved(monday_, kMonday, 0), saved(tuesday_, kTuesday, 0)});
  ASSERT_EQ(write_store(both, map_), "");
  const SavedMap read = read_saved_map(map_);
  ASSERT_EQ(read.submaps.size(), 2 * kCount);
  for (std::size_t i = 0; i < 2 * kCount; ++i) {
    EXPECT_EQ(read.headers[i].run, i < kCount ? kMonday : kTuesday);
    EXPECT_EQ(read.submaps[i].sweep, 10 * (i % kCount));
  }
  EXPECT_FALSE(read.submaps[kCount].connected);
}

// As where a run was killed before its mapping had stored any cube.
TEST_F(MergedStore, WhatARobotHasToKnowIsSaid) {
  EXPECT_TRUE(notes(found_).empty());
  EXPECT_TRUE(lacking(found_).empty());
  found_.maps[1].folder = "tuesday";
  found_.maps[1].robot = "other";
  found_.maps[1].voxels.clear();
  ASSERT_EQ(notes(found_).size(), 1U);
  EXPECT_NE(notes(found_)[0].find("of robot other"), std::string::npos);
  ASSERT_EQ(lacking(found_).size(), 1U);
  EXPECT_TRUE(lacking(found_)[0].starts_with("tuesday: "));
}

TEST_F(MergedStore, AFolderThatCantBeWrittenIsNamed) {
  std::ofstream(map_) << "a file";
  EXPECT_NE(write_store(found_, map_).find(map_.string()), std::string::npos);
}

}  // namespace
}  // namespace zloam::sessions
