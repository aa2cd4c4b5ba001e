// A scan that arrives in slices: one of ten consecutive poses has points, those of a whole turn of
// the motor.

#include <gtest/gtest.h>

#include <cmath>

#include "mapping/mapping.hpp"
#include "mapping/test_room.hpp"

namespace zloam::mapping {
namespace {

constexpr std::uint32_t kSlices = 10;
constexpr std::uint32_t kSlice_ns = 100'000'000;

bool ends_turn(int slice) { return slice >= 19 && slice % 10 == 9; }

// Each scan is taken at rest, so that it needs no deskewing.
Pose truth(int slice) {
  Vector6 step;
  step << 0.003, 0.001, 0.0, 0.0, 0.0, 0.0005;
  return exp_se3(slice * step);
}

struct Scanner {
  test::Room room = test::furnished_room();
  double plane_gap_m = 0.2;
  double max_range_m = 60.0;
  std::uint32_t every = 1;

  /// With exact odometry; nothing for a slice that mapping.every leaves out.
  MappingResult feed(Mapper& mapper, int slice, const Pose& T_map_base) const {
    const test::Scan scan =
        test::scan(room, T_map_base, 0.01, static_cast<unsigned>(slice), max_range_m, plane_gap_m);
    MappingInput input;
    input.sweep = static_cast<std::uint64_t>(slice);
    input.stamp_ns = std::int64_t{slice} * kSlice_ns;
    input.instant_ns = input.period_ns = kSlice_ns;
    input.slices = kSlices;
    input.T_odom_base = T_map_base;
    // Other than zero: the motion is known.
    input.twist_per_s.x() = 1e-12;
    if (ends_turn(slice)) {
      input.edges = scan.edges;
      input.planes = scan.planes;
    }
    return input.is_mapped(every) ? mapper.process(input) : MappingResult{};
  }
};

// Nothing of the map within the range of the scanner.
test::Room far_away() { return {{{-90.0, -90.0, -40.0}, {90.0, 90.0, 40.0}}, {}}; }

TEST(Slices, TurnsThatMatchNothingAreLostAndThenFoundAgain) {
  MappingConfig config;
  config.bridge_sweeps = 3;
  Mapper mapper{config};
  Scanner scanner;
  int slice = 0;
  for (; slice < 100; ++slice) scanner.feed(mapper, slice, truth(slice));
  scanner.room = far_away();
  scanner.max_range_m = 200.0;
  for (; slice < 150; ++slice) {
    const Health health = scanner.feed(mapper, slice, truth(slice)).health;
    const int turns = (slice - 99) / 10;
    const Health wanted =
        turns == 0 ? Health::kOk : (turns <= 3 ? Health::kPredicted : Health::kLost);
    EXPECT_EQ(health, wanted) << slice;
  }
  scanner.room = test::furnished_room();
  MappingResult last;
  for (; slice < 200; ++slice) last = scanner.feed(mapper, slice, truth(slice));
  EXPECT_EQ(last.health, Health::kOk) << last.reason;
  EXPECT_TRUE(last.inserted);
  EXPECT_LT((truth(199).inverse() * last.T_map_base).translation().norm(), 0.03);
}

TEST(Slices, EachTurnIsMappedWhicheverSweepsAre) {
  for (const std::uint32_t every : {1U, 2U, 3U, 10U}) {
    Mapper mapper{MappingConfig{}};
    const Scanner scanner{.every = every};
    int inserted = 0;
    for (int slice = 0; slice < 50; ++slice) {
      inserted += scanner.feed(mapper, slice, truth(slice)).inserted ? 1 : 0;
    }
    EXPECT_EQ(inserted, 4) << every;
    EXPECT_GT(mapper.point_count(), 0U) << every;
  }
}

TEST(Slices, PosesBetweenTwoTurnsAreDegenerateWhereTheTurnWas) {
  Mapper mapper{MappingConfig{}};
  const Scanner scanner{.room = test::corridor(), .plane_gap_m = 0.7};
  const auto along = [](int slice) {
    return pose_from_xyz_rpy_deg({0.005 * slice, 0.0, 0.0}, {0.0, 0.0, 0.0});
  };
  int slice = 0;
  for (; !ends_turn(slice) || slice < 160; ++slice) scanner.feed(mapper, slice, along(slice));
  const MappingResult turn = scanner.feed(mapper, slice, along(slice));
  ASSERT_EQ(turn.health, Health::kDegenerate);
  for (int i = 1; i < 10; ++i) {
    // Turns on the spot: the corridor's axis turns in the axes of the robot.
    const double yaw_rad = 0.1 * i;
    Pose T_map_base = along(slice + i);
    T_map_base.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    const MappingResult between = scanner.feed(mapper, slice + i, T_map_base);
    EXPECT_EQ(between.health, Health::kDegenerate) << i;
    ASSERT_TRUE(between.degeneracy.degenerate) << i;
    const Eigen::Vector3d axis_base(std::cos(yaw_rad), -std::sin(yaw_rad), 0.0);
    EXPECT_GT(std::abs(between.degeneracy.weak_translation.dot(axis_base)), 0.99) << i;
  }
}

TEST(Slices, WhileThePoseIsSearchedForItsCovarianceIsThatOfTheSearch) {
  const MappingConfig config{};
  Mapper mapper{config};
  const Scanner scanner;
  int slice = 0;
  for (; slice < 60; ++slice) scanner.feed(mapper, slice, truth(slice));
  mapper.place(pose_from_xyz_rpy_deg({3.0, -1.0, 0.0}, {0.0, 0.0, 90.0}));
  for (; slice < 69; ++slice) {
    const MappingResult result = scanner.feed(mapper, slice, truth(slice));
    EXPECT_EQ(result.health, Health::kBridging) << slice;
    EXPECT_GE(result.covariance(0, 0), config.bridge_distance_m * config.bridge_distance_m);
  }
}

}  // namespace
}  // namespace zloam::mapping
