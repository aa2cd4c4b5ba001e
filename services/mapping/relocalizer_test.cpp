// A robot at an unknown pose in a fixed map: found where the map is unambiguous, lost elsewhere.

#include "mapping/relocalizer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "mapping/mapping.hpp"
#include "mapping/odometry_watch.hpp"
#include "mapping/test_room.hpp"

namespace zloam::mapping {
namespace {

constexpr std::uint32_t kPeriod_ns = 100'000'000;
constexpr double kStep_m = 0.1;
constexpr int kSweeps = 40;

Pose at(double x, double y, double yaw_deg) {
  return pose_from_xyz_rpy_deg({x, y, 0.0}, {0.0, 0.0, yaw_deg});
}

/// A hall that looks the same from its other end.
test::Room hall() { return {{{-9.0, -5.0, -1.3}, {9.0, 5.0, 2.7}}, {}}; }

/// A furnished room whose pillars stand elsewhere.
test::Room other_room() {
  return {{{-7.0, -9.0, -1.3}, {9.0, 4.0, 2.7}},
          {{{-3.0, 1.0, -1.3}, {-1.5, 2.0, 2.7}}, {{3.0, -5.0, -1.3}, {3.6, -3.0, 1.5}}}};
}

/// Input as the stage gets it: a sweep deskewed to its end.
MappingInput input_of(int sweep, std::uint32_t epoch, const test::Scan& scan,
                      const Pose& T_odom_base) {
  MappingInput input;
  input.sweep = static_cast<std::uint64_t>(sweep);
  input.stamp_ns = std::int64_t{sweep} * kPeriod_ns;
  input.instant_ns = input.period_ns = kPeriod_ns;
  input.odom_epoch = epoch;
  input.T_odom_base = T_odom_base;
  input.edges = scan.edges;
  input.planes = scan.planes;
  return input;
}

SavedMap mapped(const test::Room& room) {
  Mapper mapper{MappingConfig{}};
  SavedMap saved;
  for (int i = 0; i < 30; ++i) {
    const Pose truth = at(-3.0 + 0.2 * i, -2.0 + 0.15 * i, 4.0 * i);
    const test::Scan scan = test::scan(room, truth, 0.01, 100U + static_cast<unsigned>(i));
    const MappingResult result = mapper.process(input_of(i, 0, scan, truth));
    saved.T_map_base = result.T_map_base;
  }
  for (const TileId& id : mapper.tiles()) saved.tiles.push_back(*mapper.tile(id));
  saved.voxels = mapper.take_changed_voxels(0.0);
  return saved;
}

struct Found {
  int sweeps = 0;
  double worst_m = 0.0, worst_rad = 0.0;
};

class Kidnapped : public ::testing::Test {
 protected:
  static Mapper localizing(const test::Room& room) {
    MappingConfig config;
    config.mode = MappingMode::kLocalize;
    Mapper mapper(config);
    mapper.restore(mapped(room));
    return mapper;
  }

  /// Drives ahead from `start`, an hour after the map was built, so that its pose is unknown.
  static Found drive(Mapper& mapper, const test::Room& room, const Pose& start,
                     double step_m = kStep_m) {
    Found found;
    const Pose T_odom_start = at(40.0, -7.0, 65.0);
    for (int i = 0; i < kSweeps; ++i) {
      const Pose moved = at(step_m * i, 0.0, 0.0);
      const Pose truth = start * moved;
      const test::Scan scan = test::scan(room, truth, 0.01, 500U + static_cast<unsigned>(i));
      const MappingResult r = mapper.process(input_of(36'000 + i, 1, scan, T_odom_start * moved));
      if (r.health != Health::kOk && r.health != Health::kDegenerate) continue;
      const Pose off = truth.inverse() * r.T_map_base;
      ++found.sweeps;
      found.worst_m = std::max(found.worst_m, off.translation().norm());
      found.worst_rad = std::max(found.worst_rad, Eigen::AngleAxisd(off.linear()).angle());
    }
    return found;
  }
};

TEST_F(Kidnapped, IsFoundWhereverItWasPutDown) {
  const test::Room room = test::furnished_room();
  for (const Pose& start : {at(-6.0, 5.0, -90.0), at(9.0, -3.0, 120.0), at(1.0, 5.5, 200.0)}) {
    Mapper mapper = localizing(room);
    const Found found = drive(mapper, room, start);
    EXPECT_GT(found.sweeps, 10) << start.translation().transpose();
    EXPECT_LT(found.worst_m, 0.05);
    EXPECT_LT(found.worst_rad, 0.01);
  }
}

TEST_F(Kidnapped, IsFoundAgainAfterAnotherPlace) {
  const test::Room room = test::furnished_room();
  Mapper mapper = localizing(room);
  EXPECT_GT(drive(mapper, room, at(-6.0, 5.0, -90.0)).sweeps, 10);
  const Pose start = at(9.0, -3.0, 120.0);
  int last = 0;
  for (int i = 0; i < kSweeps; ++i) {
    const Pose moved = at(kStep_m * i, 0.0, 0.0);
    const test::Scan scan = test::scan(room, start * moved, 0.01, 700U + static_cast<unsigned>(i));
    // The odometry did not observe that the robot was carried.
    const MappingResult r =
        mapper.process(input_of(72'000 + i, 1, scan, at(44.0, -7.0, 65.0) * moved));
    if (r.health != Health::kOk) continue;
    ++last;
    EXPECT_LT((start * moved).translation().x() - r.T_map_base.translation().x(), 0.05) << i;
    EXPECT_LT(((start * moved).inverse() * r.T_map_base).translation().norm(), 0.05) << i;
  }
  EXPECT_GT(last, 10);
}

// mapping.every 11, or a busy host: the odometry has followed the sweeps between the mapped ones.
TEST_F(Kidnapped, IsFoundThoughFewSweepsAreMapped) {
  constexpr int kEvery = 11;
  const test::Room room = test::furnished_room();
  Mapper mapper = localizing(room);
  const Pose start = at(-6.0, 5.0, -90.0);
  OdometryWatch watch;
  int found = 0;
  for (int i = 0; i < kSweeps * kEvery; ++i) {
    const int sweep = 36'000 + i;
    const Pose moved = at(kStep_m / kEvery * i, 0.0, 0.0);
    MappingInput input = input_of(sweep, 1, {}, at(40.0, -7.0, 65.0) * moved);
    watch.see(input.sweep, i == 0 ? input.sweep : input.sweep - 1, input.stamp_ns + kPeriod_ns);
    if (i % kEvery != 0) continue;
    input.unwatched_s = watch.take();
    const test::Scan scan = test::scan(room, start * moved, 0.01, 500U + static_cast<unsigned>(i));
    input.edges = scan.edges;
    input.planes = scan.planes;
    const MappingResult r = mapper.process(input);
    if (r.health != Health::kOk) continue;
    ++found;
    EXPECT_LT(((start * moved).inverse() * r.T_map_base).translation().norm(), 0.05) << i;
  }
  EXPECT_GT(found, 10);
}

TEST(OdometryWatch, TellsTheLongestTimeWithoutOdometry) {
  constexpr std::int64_t kSecond_ns = 1'000'000'000;
  OdometryWatch watch;
  watch.see(7, 6, 0);
  EXPECT_FALSE(watch.take()) << "what was before the first sweep is unknown";
  watch.see(8, 7, kSecond_ns / 10);
  watch.see(9, 8, 2 * kSecond_ns);
  watch.see(10, 9, 2 * kSecond_ns + 1);
  EXPECT_NEAR(watch.take().value_or(0.0), 1.9, 1e-6);
  // Mapping took one sweep in ten, but the odometry names the one before.
  watch.see(20, 19, 3 * kSecond_ns + 1);
  EXPECT_NEAR(watch.take().value_or(1.0), 0.1, 1e-6);
  // The sweeps between never came to the odometry.
  watch.see(30, 20, 4 * kSecond_ns + 1);
  EXPECT_NEAR(watch.take().value_or(0.0), 1.0, 1e-6);
}

TEST_F(Kidnapped, AnotherRoomIsNotTheMap) {
  Mapper mapper = localizing(test::furnished_room());
  EXPECT_EQ(drive(mapper, other_room(), at(2.0, -1.0, 30.0)).sweeps, 0);
}

TEST_F(Kidnapped, StaysLostWhereTheMapLooksTheSameTwice) {
  Mapper mapper = localizing(hall());
  EXPECT_EQ(drive(mapper, hall(), at(3.0, -2.0, 100.0)).sweeps, 0);
}

TEST_F(Kidnapped, WhoStandsStillIsNotBelieved) {
  const test::Room room = test::furnished_room();
  Mapper mapper = localizing(room);
  EXPECT_EQ(drive(mapper, room, at(9.0, -3.0, 120.0), 0.0).sweeps, 0);
}

// Of two places that look alike, the one given by the user is accepted.
TEST_F(Kidnapped, IsFoundAtOnceWhereItIsExpected) {
  Mapper mapper = localizing(hall());
  mapper.place(at(3.6, -2.4, 105.0));
  const Found found = drive(mapper, hall(), at(3.0, -2.0, 100.0), 0.0);
  EXPECT_GT(found.sweeps, kSweeps - 10);
  EXPECT_LT(found.worst_m, 0.05);
}

TEST_F(Kidnapped, IsNotFoundWhereItIsExpectedIfItIsElsewhere) {
  const test::Room room = test::furnished_room();
  Mapper mapper = localizing(room);
  mapper.place(at(-6.0, 5.0, -90.0));
  const Found found = drive(mapper, room, at(9.0, -3.0, 120.0));
  EXPECT_GT(found.sweeps, 10);
  EXPECT_LT(found.worst_m, 0.05);
}

class Extending : public Kidnapped {
 protected:
  Extending() : mapper_(extending()) {
    SavedMap saved = mapped(room_);
    saved.found = false;
    mapper_.restore(saved);
    EXPECT_GT(drive(mapper_, room_, first_start_).sweeps, 10);
  }

  static MappingConfig extending() {
    MappingConfig config;
    config.mode = MappingMode::kExtend;
    return config;
  }

  /// The sensor was off for an hour, while the robot was carried to another part of the map.
  void expect_found_elsewhere();

  const test::Room room_ = test::furnished_room();
  const Pose first_start_ = at(-6.0, 5.0, -90.0);
  Mapper mapper_;
};

void Extending::expect_found_elsewhere() {
  const Pose start = at(9.0, -3.0, 120.0);
  const std::size_t points = mapper_.point_count();
  int found = 0;
  for (int i = 0; i < kSweeps; ++i) {
    const Pose moved = at(kStep_m * i, 0.0, 0.0);
    const test::Scan scan = test::scan(room_, start * moved, 0.01, 700U + static_cast<unsigned>(i));
    const MappingResult r = mapper_.process(input_of(72'000 + i, 2, scan, moved));
    if (r.health == Health::kOk) {
      ++found;
      EXPECT_LT(((start * moved).inverse() * r.T_map_base).translation().norm(), 0.05) << i;
    } else if (found == 0) {
      EXPECT_EQ(mapper_.point_count(), points) << i;
    }
  }
  EXPECT_GT(found, 10);
}

TEST_F(Extending, IsFoundInAllOfTheMapInANewRun) {
  mapper_.place(first_start_ * at(kStep_m * (kSweeps - 1), 0.0, 0.0));
  expect_found_elsewhere();
}

TEST_F(Extending, IsFoundInAllOfTheMapAfterAPauseWithinARun) { expect_found_elsewhere(); }

TEST(WallMap, HasNoPlaceForWhatHasNoWalls) {
  std::vector<Eigen::Vector3f> ground, walls;
  for (int i = 0; i < 100; ++i) {
    for (int j = 0; j < 100; ++j) {
      ground.emplace_back(0.2F * static_cast<float>(i), 0.2F * static_cast<float>(j), 0.0F);
    }
    for (int k = 0; k < 10; ++k) {
      walls.emplace_back(0.2F * static_cast<float>(i), 3.0F, 0.2F * static_cast<float>(k));
    }
  }
  const WallMap of_ground(ground), of_walls(walls), of_nothing({});
  const Surroundings plain(ground), walled(walls), none({});
  EXPECT_TRUE(of_walls.likely_places(plain, 4).empty());
  EXPECT_TRUE(of_ground.likely_places(walled, 4).empty());
  EXPECT_TRUE(of_nothing.likely_places(walled, 4).empty());
  EXPECT_TRUE(of_walls.likely_places(none, 4).empty());
  EXPECT_FALSE(of_walls.likely_places(walled, 4).empty());
  EXPECT_NEAR(of_walls.share_at(walled, Pose::Identity()), 1.0, 1e-9);
}

// Independent reference: exhaustive search of every place and heading of the grid.
TEST(WallMap, ItsBestPlaceIsTheBestOfAll) {
  const test::Room room = test::furnished_room();
  std::vector<Eigen::Vector3f> map;
  for (const Pose& from : {at(0.0, 0.0, 0.0), at(9.0, 5.0, 40.0), at(-6.0, -4.0, 10.0)}) {
    for (const Point& p : test::scan(room, from, 0.01, 1).planes) {
      map.push_back((from * p.position().cast<double>()).cast<float>());
    }
  }
  const WallMap walls(map);
  for (const Pose& truth : {at(5.0, 4.0, 77.0), at(-6.5, 2.0, 190.0)}) {
    std::vector<Eigen::Vector3f> seen;
    for (const Point& p : test::scan(room, truth, 0.01, 2).planes) seen.push_back(p.position());
    const Surroundings around(seen);
    const auto places = walls.likely_places(around, 4);
    ASSERT_FALSE(places.empty());
    EXPECT_LT((places.front().translation() - truth.translation()).head<2>().norm(), 0.5);
    double best = 0.0;
    for (int turn = 0; turn < 128; ++turn) {
      for (double x = -8.0; x <= 12.0; x += 0.25) {
        for (double y = -6.0; y <= 8.0; y += 0.25) {
          best = std::max(best, walls.share_at(around, at(x, y, turn * 360.0 / 128.0)));
        }
      }
    }
    EXPECT_NEAR(walls.share_at(around, places.front()), best, 0.01);
  }
}

// Two rooms at opposite corners of a city: with cells of 1 m its grid would be too large.
TEST(WallMap, SearchesAMapOfManyKilometresToo) {
  const Pose here = at(0.0, 0.0, 0.0);
  std::vector<Eigen::Vector3f> map;
  for (const Point& p : test::scan(test::furnished_room(), here, 0.01, 1).planes) {
    map.push_back(p.position());
  }
  const Eigen::Vector3f far(4500.0F, 4500.0F, 0.0F);
  for (const Point& p : test::scan(other_room(), here, 0.01, 1).planes) {
    map.emplace_back(p.position() + far);
  }
  std::vector<Eigen::Vector3f> seen;
  for (const Point& p : test::scan(other_room(), here, 0.01, 2).planes) {
    seen.push_back(p.position());
  }
  const auto places = WallMap(map).likely_places(Surroundings(seen), 16);
  double nearest_m = 1e9;
  for (const Pose& place : places) {
    const Eigen::Vector3d off = place.translation() - far.cast<double>();
    nearest_m = std::min(nearest_m, off.head<2>().norm());
  }
  // Cells of 2 m, or the next one.
  EXPECT_LT(nearest_m, 3.0);
}

// 2^16 columns in a row: the one 2^16 rows farther on has the same number, modulo 2^32.
TEST(WallMap, HeightsOfAMapOf40KilometresAreThoseOfThePlace) {
  const auto scan = [](unsigned seed) {
    std::vector<Eigen::Vector3f> points;
    for (const Point& p : test::scan(other_room(), at(0.0, 0.0, 0.0), 0.01, seed).planes) {
      points.push_back(p.position());
    }
    return points;
  };
  // The room lies at a place of the coarse grid.
  std::vector<Eigen::Vector3f> map = {{-64.0F, -64.0F, 0.0F}, {32'703.75F, -64.0F, 0.0F}};
  for (const Eigen::Vector3f& p : scan(1)) map.push_back(p);
  for (const unsigned seed : {1U, 2U, 3U}) {
    for (const Eigen::Vector3f& p : scan(seed)) {
      map.emplace_back(p + Eigen::Vector3f(0.0F, 32'768.0F, -50.0F));
    }
  }
  int here = 0;
  for (const Pose& place : WallMap(map).likely_places(Surroundings(scan(4)), 1000)) {
    const bool is_here = place.translation().head<2>().norm() < 0.1 &&
                         Eigen::AngleAxisd(place.linear()).angle() < 0.01;
    if (!is_here) continue;
    ++here;
    EXPECT_NEAR(place.translation().z(), 0.0, 0.3);
  }
  EXPECT_EQ(here, 1);
}

TEST(WallMap, SeesThroughWallsThatAreNotThere) {
  const test::Room room = test::furnished_room();
  const Pose truth = at(0.0, 0.0, 0.0);
  std::vector<Eigen::Vector3f> map;
  for (const Point& p : test::scan(room, truth, 0.01, 1).planes) map.push_back(p.position());
  const WallMap walls(map);
  const test::Scan own = test::scan(room, truth, 0.01, 2);
  const SweepView view(input_of(0, 0, own, truth));
  EXPECT_LT(walls.seen_through(view, truth), 0.01);
  // A pose two metres nearer to a wall than the true one.
  EXPECT_GT(walls.seen_through(view, at(2.0, 0.0, 0.0)), 0.1);
}

}  // namespace
}  // namespace zloam::mapping
