// A scan that arrives in slices: one of ten consecutive poses has points, those of a whole turn of
// the motor.

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

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
  Pose T_odom_map = Pose::Identity();

  std::uint32_t every = 1;

  /// Nothing for a slice that mapping.every leaves out.
  MappingResult feed(Mapper& mapper, int slice, const Pose& T_map_base) const {
    const test::Scan scan =
        test::scan(room, T_map_base, 0.01, static_cast<unsigned>(slice), 60.0, plane_gap_m);
    MappingInput input;
    input.sweep = static_cast<std::uint64_t>(slice);
    input.stamp_ns = std::int64_t{slice} * kSlice_ns;
    input.instant_ns = input.period_ns = kSlice_ns;
    input.slices = kSlices;
    input.T_odom_base = T_odom_map * T_map_base;
    // Other than zero: the motion is known.
    input.twist_per_s.x() = 1e-12;
    if (ends_turn(slice)) {
      input.edges = scan.edges;
      input.planes = scan.planes;
    }
    return input.is_mapped(every) ? mapper.process(input) : MappingResult{};
  }
};

// The odometry says Ok although its frame has turned: a match at the right place contradicts it.
TEST(Slices, AnOdometryThatEachTurnContradictsIsLostAndFoundAgain) {
  MappingConfig config;
  config.bridge_sweeps = 3;
  Mapper mapper{config};
  Scanner scanner;
  int slice = 0;
  for (; slice < 100; ++slice) scanner.feed(mapper, slice, truth(slice));
  scanner.T_odom_map.linear() =
      Eigen::AngleAxisd(0.12, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  std::vector<MappingResult> turns;
  for (; slice < 200; ++slice) {
    const MappingResult result = scanner.feed(mapper, slice, truth(slice));
    if (ends_turn(slice)) turns.push_back(result);
    if (turns.size() == 1) {
      EXPECT_EQ(result.health, Health::kPredicted) << slice;
    }
    if (turns.size() == 4) {
      EXPECT_EQ(result.health, Health::kLost) << slice;
    }
  }
  EXPECT_EQ(turns.back().health, Health::kOk) << turns.back().reason;
  EXPECT_TRUE(turns.back().inserted);
  EXPECT_LT((truth(199).inverse() * turns.back().T_map_base).translation().norm(), 0.03);
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
