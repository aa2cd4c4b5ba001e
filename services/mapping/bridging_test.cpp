// After a restart of the odometry's frame: where the sweep is searched for, and which matches are
// accepted.

#include "mapping/bridging.hpp"

#include <gtest/gtest.h>

#include "mapping/mapping.hpp"
#include "mapping/place_search.hpp"
#include "mapping/test_room.hpp"
#include "mapping/tile_map.hpp"

namespace zloam::mapping {
namespace {

constexpr std::uint32_t kPeriod_ns = 100'000'000;

MappingInput input_of(int sweep, const test::Scan& scan, const Pose& T_odom_base) {
  MappingInput input;
  input.sweep = static_cast<std::uint64_t>(sweep);
  input.stamp_ns = static_cast<std::int64_t>(sweep) * kPeriod_ns;
  input.instant_ns = input.period_ns = kPeriod_ns;
  input.T_odom_base = T_odom_base;
  input.edges = scan.edges;
  input.planes = scan.planes;
  return input;
}

Pose at(double x, double y, double z, double yaw_rad) {
  Pose pose = Pose::Identity();
  pose.translation() << x, y, z;
  pose.linear() = exp_so3({0.0, 0.0, yaw_rad});
  return pose;
}

double apart_m(const Pose& a, const Pose& b) { return (a.inverse() * b).translation().norm(); }

double apart_rad(const Pose& a, const Pose& b) {
  return Eigen::AngleAxisd((a.inverse() * b).linear()).angle();
}

TileMap map_of(const test::Room& room) {
  TileMap tiles{MappingConfig{}};
  const test::Scan scan = test::scan(room, Pose::Identity(), 0.01, 1);
  tiles.insert(Layer::kEdge, scan.edges, Pose::Identity());
  tiles.insert(Layer::kPlane, scan.planes, Pose::Identity());
  return tiles;
}

TEST(LikelyPlaces, TheFirstIsTheRightOne) {
  const test::Room room = test::furnished_room();
  const TileMap tiles = map_of(room);
  for (const Pose& truth : {at(0.0, 0.0, 0.0, 0.0), at(3.2, -2.4, 0.1, 0.5),
                            at(-4.1, 2.7, -0.1, -1.0), at(5.3, 3.3, 0.0, 0.2)}) {
    const test::Scan scan = test::scan(room, truth, 0.01, 7);
    const MappingInput input = input_of(0, scan, Pose::Identity());
    for (const double distance_m : {8.0, 20.0}) {
      const auto places = likely_places(tiles, input, Pose::Identity(), {distance_m, 1.2}, 4);
      ASSERT_FALSE(places.empty());
      EXPECT_LE(places.size(), 4U);
      // within a step or two of the grid
      EXPECT_LT(apart_m(places.front(), truth), distance_m > 10.0 ? 1.2 : 0.6);
      EXPECT_LT(apart_rad(places.front(), truth), 0.11);
    }
  }
}

TEST(LikelyPlaces, NoneWithoutPointsOrMap) {
  const test::Room room = test::furnished_room();
  const test::Scan scan = test::scan(room, Pose::Identity(), 0.01, 7);
  const MappingInput input = input_of(0, scan, Pose::Identity());
  const TileMap empty{MappingConfig{}};
  EXPECT_TRUE(likely_places(empty, input, Pose::Identity(), {8.0, 0.5}, 4).empty());
  EXPECT_TRUE(likely_places(map_of(room), {}, Pose::Identity(), {8.0, 0.5}, 4).empty());
}

TEST(Agreement, ThreeInARowBearEachOtherOut) {
  Agreement agreement;
  const Pose T_map_odom = at(40.0, 3.0, 0.0, 0.3);
  EXPECT_FALSE(agreement.add(T_map_odom, at(0.0, 0.0, 0.0, 0.0)));
  EXPECT_FALSE(agreement.add(T_map_odom * at(0.05, 0.0, 0.0, 0.001), at(1.0, 0.0, 0.0, 0.0)));
  EXPECT_TRUE(agreement.add(T_map_odom, at(2.0, 0.0, 0.0, 0.1)));
  // A different frame restarts the count.
  EXPECT_FALSE(agreement.add(T_map_odom * at(2.0, 0.0, 0.0, 0.0), at(3.0, 0.0, 0.0, 0.1)));
  EXPECT_FALSE(agreement.add(T_map_odom, at(4.0, 0.0, 0.0, 0.1)));
  EXPECT_FALSE(agreement.add(T_map_odom, at(5.0, 0.0, 0.0, 0.1)));
  EXPECT_TRUE(agreement.add(T_map_odom, at(6.0, 0.0, 0.0, 0.1)));
  agreement.reset();
  EXPECT_FALSE(agreement.add(T_map_odom, at(7.0, 0.0, 0.0, 0.1)));
}

// A drive that is unobserved for seconds, followed by sweeps without points: which pose the mapper
// then assumes.
struct Unseen {
  Unseen() {
    for (int i = 0; i < 10; ++i) {
      const Pose pose = at(0.1 * i, 0.0, 0.0, 0.0);
      const test::Scan scan = test::scan(room, pose, 0.01, 1U + static_cast<unsigned>(i));
      MappingInput input = input_of(i, scan, pose);
      input.twist_per_s = twist_per_s;
      last = mapper.process(input).T_map_base;
    }
  }
  Pose empty_sweep(int sweep, std::uint32_t epoch) {
    MappingInput input = input_of(sweep, {}, Pose::Identity());
    input.odom_epoch = epoch;
    return mapper.process(input).T_map_base;
  }
  test::Room room = test::furnished_room();
  // slow pitching, which no platform continues for seconds
  Vector6 twist_per_s = (Vector6() << 1.0, 0.0, 0.0, 0.0, 0.1, 0.0).finished();
  Mapper mapper{MappingConfig{}};
  Pose last = Pose::Identity();
};

TEST(Bridging, ATiltDoesNotGrowWhileNothingIsSeen) {
  Unseen drive;
  const Pose found = drive.empty_sweep(9 + 30, 1);
  EXPECT_LT(apart_m(found, at(drive.last.translation().x() + 3.0, 0.0, 0.0, 0.0)), 0.1);
  EXPECT_LT(apart_rad(found, drive.last), 0.01);
}

TEST(Bridging, AFrameThatBreaksOffAtOnceTellsNothingOfTheMotion) {
  Unseen drive;
  drive.empty_sweep(9 + 15, 1);
  const Pose found = drive.empty_sweep(9 + 30, 2);
  EXPECT_LT(apart_m(found, at(drive.last.translation().x() + 3.0, 0.0, 0.0, 0.0)), 0.1);
}

}  // namespace
}  // namespace zloam::mapping
