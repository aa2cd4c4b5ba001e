#include "common/plane_map/scan_to_map.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <limits>

#include "common/geometry/deskew.hpp"
#include "common/plane_map/tests/room.hpp"

namespace zloam::plane_map {
namespace {

using testing::Room;
using testing::scan;
using testing::Scanner;

constexpr std::int64_t kPeriod_ns = 100'000'000;

Vector6 twist(double x, double y, double z, double rx, double ry, double rz) {
  Vector6 v;
  v << x, y, z, rx, ry, rz;
  return v;
}

SweepInput input(const PointVector& points, int number) {
  SweepInput sweep;
  sweep.points = points;
  sweep.stamp_ns = number * kPeriod_ns;
  return sweep;
}

// For scans without noise: only thin planes are accepted, so voxels with a corner are no planes.
PlaneMapConfig exact() {
  PlaneMapConfig config;
  config.range_noise_m = 0.002;
  return config;
}

struct Drive {
  std::vector<Pose> truth_mid;
  std::vector<ScanToMapResult> results;
};

// Two sweeps at rest, a ramp up to the twist over `ramp` sweeps, then `steady` sweeps at it.
Drive drive(ScanToMap& tracker, const Room& room, const Scanner& scanner,
            const Vector6& twist_per_s, int ramp, int steady) {
  std::mt19937 random(1);
  Drive out;
  Pose T_start = Pose::Identity();
  for (int k = 0; k < 2 + ramp + steady; ++k) {
    const Vector6 v = twist_per_s * std::clamp((k - 1.0) / (ramp + 1), 0.0, 1.0);
    const PointVector points = scan(room, scanner, T_start, v, random);
    out.results.push_back(tracker.process(input(points, k)));
    out.truth_mid.push_back(T_start * exp_se3(0.05 * v));
    T_start = T_start * exp_se3(0.1 * v);
  }
  return out;
}

double distance_m(const Pose& a, const Pose& b) {
  return (a.translation() - b.translation()).norm();
}
double angle_rad(const Pose& a, const Pose& b) {
  return log_so3(a.linear().transpose() * b.linear()).norm();
}

// The map is built from true poses, so that only the matcher can err.
class OneSweep : public ::testing::TestWithParam<int> {};

TEST_P(OneSweep, IsMatched) {
  PlaneMapConfig config = exact();
  config.distributions = false;
  VoxelPlaneMap map(config);
  std::mt19937 random(1);
  for (int k = 0; k < 12; ++k) {
    const Pose T = pose_from_xyz_rpy_deg({0.15 * k - 0.9, 0.1 * k - 0.6, 0.03 * k},
                                         {2.0 * k - 10, 8.0 - k, 25.0 * k});
    std::vector<Eigen::Vector3d> points;
    for (const Point& p : scan(Room{}, Scanner{}, T, Vector6::Zero(), random)) {
      points.push_back(T * p.position().cast<double>());
    }
    map.insert_points(points);
  }
  Vector6 v = Vector6::Zero();
  v[GetParam()] = GetParam() < 3 ? 0.6 : 0.4;
  const Pose T_start = pose_from_xyz_rpy_deg({0.1, -0.2, 0.05}, {1.0, -0.5, 3.0});
  const PointVector cloud = scan(Room{}, Scanner{}, T_start, v, random);
  const SweepPoints points(input(cloud, 0), 0.5);
  MotionPrior prior;  // a start with an error, and a prior with hardly any information
  prior.start.T_mid = map.T_grid_map() * T_start;
  prior.predicted = prior.start;
  prior.information = 1e-3 * Matrix12::Identity();
  map.set_anchor(prior.start.T_mid.translation());
  MatcherConfig matcher;
  matcher.max_iterations = 30;
  const MatchResult result = SweepMatcher(matcher).match(map, points, prior, {{0.3, 0.1}, 1.0});
  ASSERT_TRUE(result.valid);
  const Pose truth = map.T_grid_map() * T_start * exp_se3(0.05 * v);
  EXPECT_LT(distance_m(result.motion.T_mid, truth), 6e-4);
  EXPECT_LT(angle_rad(result.motion.T_mid, truth), 3e-4);
  EXPECT_LT((result.motion.twist - 0.1 * v).norm(), 3e-3);
}

INSTANTIATE_TEST_SUITE_P(Axes, OneSweep, ::testing::Range(0, 6));

class KnownMotion : public ::testing::TestWithParam<int> {};

TEST_P(KnownMotion, IsFollowedWithoutNoise) {
  Vector6 v = Vector6::Zero();
  v[GetParam()] = GetParam() < 3 ? 0.4 : 0.3;
  ScanToMap tracker{exact(), MatcherConfig{}};
  const Drive d = drive(tracker, Room{}, Scanner{}, v, 12, 6);
  const ScanToMapResult& last = d.results.back();
  EXPECT_EQ(last.outcome, Outcome::kMatched);
  EXPECT_LT(distance_m(last.T_map_base_mid, d.truth_mid.back()), 1.5e-3);
  EXPECT_LT(angle_rad(last.T_map_base_mid, d.truth_mid.back()), 1.5e-3);
  EXPECT_LT((last.twist_per_s - v).norm(), 0.1);
  // Voxels that one ring alone has seen are no planes: their points stay unmatched.
  EXPECT_GT(last.matched_fraction, 2.0 / 3.0);
}

TEST_P(KnownMotion, IsRecoveredUnderNoise) {
  Vector6 v = Vector6::Zero();
  v[GetParam()] = GetParam() < 3 ? -0.5 : 0.5;
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  const Drive d = drive(tracker, Room{}, scanner, v, 12, 6);
  const ScanToMapResult& last = d.results.back();
  EXPECT_LT(distance_m(last.T_map_base_mid, d.truth_mid.back()), 0.010);
  EXPECT_LT(angle_rad(last.T_map_base_mid, d.truth_mid.back()), 0.003);
  EXPECT_NEAR(last.residual_rms_m, 0.02, 0.006);
}

INSTANTIATE_TEST_SUITE_P(Axes, KnownMotion, ::testing::Range(0, 6));

TEST(ScanToMap, FastTurnNeedsTheSweepsOwnMotion) {
  // 115 deg/s from rest: with the last sweep's motion (none) points would be off by up to 0.1 rad.
  const Vector6 v = twist(0.5, 0.2, 0.0, 0.0, 0.0, 2.0);
  ScanToMap tracker{exact(), MatcherConfig{}};
  const Drive d = drive(tracker, Room{}, Scanner{}, v, 0, 1);
  EXPECT_LT(distance_m(d.results.back().T_map_base_mid, d.truth_mid.back()), 0.01);
  EXPECT_LT(angle_rad(d.results.back().T_map_base_mid, d.truth_mid.back()), 0.005);
  EXPECT_NEAR(d.results.back().twist_per_s[5], 2.0, 0.1);
}

TEST(ScanToMap, EndIsHalfASweepAfterTheMiddle) {
  const Vector6 v = twist(1.0, 0.0, 0.0, 0.0, 0.0, 0.5);
  ScanToMap tracker{exact(), MatcherConfig{}};
  const Drive d = drive(tracker, Room{}, Scanner{}, v, 12, 6);
  const Pose truth_end = d.truth_mid.back() * exp_se3(0.05 * v);
  EXPECT_LT(distance_m(d.results.back().T_map_base_end, truth_end), 2e-3);
  EXPECT_LT(angle_rad(d.results.back().T_map_base_end, truth_end), 1e-3);
}

TEST(ScanToMap, DeskewedInputGivesTheSameAsRaw) {
  const Vector6 v = twist(0.8, -0.3, 0.1, 0.1, -0.1, 0.8);
  const Vector6 wrong = twist(0.5, 0.1, 0.0, 0.0, 0.1, 0.5);  // what odometry believed
  ScanToMap raw{exact(), MatcherConfig{}};
  ScanToMap undone{exact(), MatcherConfig{}};
  std::mt19937 random(4);
  Pose T_start = Pose::Identity();
  for (int k = 0; k < 6; ++k) {
    const PointVector points = scan(Room{}, Scanner{}, T_start, v, random);
    const auto period = static_cast<std::uint32_t>(kPeriod_ns);
    const PointVector moved = deskewed(points, DeskewTable(wrong, period, period));
    SweepInput sweep = input(moved, k);
    sweep.deskewed = Deskewing{wrong, period};
    const Pose a = raw.process(input(points, k)).T_map_base_mid;
    const Pose b = undone.process(sweep).T_map_base_mid;
    EXPECT_LT(distance_m(a, b), 1e-3) << k;
    EXPECT_LT(angle_rad(a, b), 3e-4) << k;
    T_start = T_start * exp_se3(0.1 * v);
  }
}

TEST(ScanToMap, MountingCarriesPointsToBaseLink) {
  const Vector6 v = twist(0.4, 0.1, 0.0, 0.0, 0.0, 0.6);  // of base_link
  const Pose T_base_lidar = pose_from_xyz_rpy_deg({0.3, -0.1, 0.4}, {5, -10, 90});
  ScanToMap tracker{exact(), MatcherConfig{}};
  std::mt19937 random(8);
  Pose T_room_base = Pose::Identity();
  ScanToMapResult result;
  Vector6 now;
  for (int k = 0; k < 16; ++k) {
    now = std::min(1.0, k / 10.0) * v;
    const Vector6 v_lidar = adjoint(T_base_lidar.inverse()) * now;
    const PointVector points = scan(Room{}, Scanner{}, T_room_base * T_base_lidar, v_lidar, random);
    SweepInput sweep = input(points, k);
    sweep.T_base_points = T_base_lidar;
    result = tracker.process(sweep);
    T_room_base = T_room_base * exp_se3(0.1 * now);
  }
  EXPECT_LT(distance_m(result.T_map_base_end, T_room_base), 3e-3);
  EXPECT_LT(angle_rad(result.T_map_base_end, T_room_base), 1e-3);
  EXPECT_LT((result.twist_per_s - v).norm(), 0.05);
}

TEST(ScanToMap, EndlessCorridorIsFlaggedAlongItsAxis) {
  Room corridor;
  corridor.open_x = true;
  corridor.low.y() = -1.5;
  corridor.high.y() = 1.5;
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  const Drive d = drive(tracker, corridor, scanner, Vector6::Zero(), 0, 6);
  for (std::size_t k = 3; k < d.results.size(); ++k) {
    const Degeneracy& degeneracy = d.results[k].degeneracy;
    EXPECT_TRUE(degeneracy.weak) << k;
    EXPECT_GT(std::abs(degeneracy.axis.x()), 0.99) << k;
    EXPECT_GT(degeneracy.measured_sigma_m, 0.5 * degeneracy.predicted_sigma_m) << k;
    EXPECT_LT(degeneracy.share, 0.01) << k;
  }
}

TEST(ScanToMap, ClosedRoomIsNotFlagged) {
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  const Drive d = drive(tracker, Room{}, scanner, twist(0.5, 0, 0, 0, 0, 0.3), 4, 6);
  for (std::size_t k = 1; k < d.results.size(); ++k) {
    EXPECT_FALSE(d.results[k].degeneracy.weak) << k;
    EXPECT_LT(d.results[k].degeneracy.measured_sigma_rad, 0.01) << k;
    EXPECT_GT(d.results[k].degeneracy.share, 0.02) << k;
  }
}

// The prediction of an odometry without errors.
MotionPrediction true_motion(const Pose& T_start, const Vector6& twist_per_s, double pose_variance,
                             double twist_variance) {
  MotionPrediction odometry;
  odometry.T_map_base = T_start * exp_se3(0.05 * twist_per_s);
  odometry.instant_ns = 50'000'000;
  odometry.twist_per_s = twist_per_s;
  odometry.pose_covariance = pose_variance * Matrix6::Identity();
  odometry.twist_covariance = twist_variance * Matrix6::Identity();
  return odometry;
}

TEST(ScanToMap, CorridorKeepsThePredictedMotionAlongItsAxis) {
  Room corridor;
  corridor.open_x = true;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  std::mt19937 random(2);
  const Vector6 v = twist(1.0, 0, 0, 0, 0, 0);
  Pose T_start = Pose::Identity();
  ScanToMapResult result;
  Scanner scanner;
  scanner.noise_m = 0.01;
  for (int k = 0; k < 12; ++k) {
    const PointVector points = scan(corridor, scanner, T_start, v, random);
    MotionPrediction odometry = true_motion(T_start, v, 1e-4, 1e-2);
    odometry.use = PredictionUse::kInstead;
    result = tracker.process(input(points, k), odometry);
    T_start = T_start * exp_se3(0.1 * v);
  }
  EXPECT_NEAR(result.T_map_base_end.translation().x(), 1.2, 0.05);
  EXPECT_LT(std::abs(result.T_map_base_end.translation().y()), 0.01);
}

// Estimated distance along an endless corridor; odometry gives the speed in the first six sweeps.
double way_in_a_corridor_m(const PlaneMapConfig& map, const Vector6& v, int sweeps) {
  Room corridor;
  corridor.open_x = true;
  ScanToMap tracker{map, MatcherConfig{}};
  std::mt19937 random(2);
  Pose T_start = Pose::Identity();
  ScanToMapResult result;
  Scanner scanner;
  scanner.noise_m = 0.02;
  for (int k = 0; k < sweeps; ++k) {
    const PointVector points = scan(corridor, scanner, T_start, v, random);
    MotionPrediction odometry = true_motion(T_start, v, 1e-6, 1e-4);
    odometry.use = PredictionUse::kInstead;
    result =
        k < 6 ? tracker.process(input(points, k), odometry) : tracker.process(input(points, k));
    T_start = T_start * exp_se3(0.1 * v);
  }
  return result.T_map_base_end.translation().x();
}

// The trace of one ring across the floor and a few points on the wall form phantom planes that move
// with the sensor: if accepted, they hold it back at once. Here all sweeps have the same beam
// directions and nothing constrains the corridor's axis, so other such errors stop it in the end.
TEST(ScanToMap, AlongAnEmptyCorridorTracesOfOneRingHoldItBackTheLessTheyCount) {
  const Vector6 v = twist(1.0, 0, 0, 0, 0, 0);
  PlaneMapConfig believing, doubting;
  believing.one_ring_lead = 1.0;
  doubting.one_ring_lead = 0.5;
  const double believed_m = way_in_a_corridor_m(believing, v, 20);
  EXPECT_LT(believed_m, 1.0);  // of 2
  EXPECT_GT(way_in_a_corridor_m(PlaneMapConfig{}, v, 20), believed_m + 0.2);
  EXPECT_GT(way_in_a_corridor_m(doubting, v, 20), 1.6);
}

TEST(ScanToMap, SameInputGivesTheSameBytes) {
  const Vector6 v = twist(0.5, 0.2, 0.1, 0.1, 0.2, 0.7);
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap first{PlaneMapConfig{}, MatcherConfig{}};
  ScanToMap second{PlaneMapConfig{}, MatcherConfig{}};
  const Drive a = drive(first, Room{}, scanner, v, 4, 4);
  std::vector<std::vector<char>> noise(100, std::vector<char>(1000));  // other addresses
  const Drive b = drive(second, Room{}, scanner, v, 4, 4);
  for (std::size_t k = 0; k < a.results.size(); ++k) {
    EXPECT_EQ(0, std::memcmp(a.results[k].T_map_base_end.data(), b.results[k].T_map_base_end.data(),
                             16 * sizeof(double)));
    EXPECT_EQ(0, std::memcmp(a.results[k].covariance.data(), b.results[k].covariance.data(),
                             144 * sizeof(double)));
  }
}

// Error of the pose when the sensor sees the other side, 0.2 m behind, of a mapped wall 5 m ahead.
double drawn_by_a_walls_other_side_m(const MatcherConfig& matcher) {
  Room other_side;
  other_side.high.x() += 0.2;
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, matcher};
  drive(tracker, Room{}, scanner, Vector6::Zero(), 0, 18);
  std::mt19937 random(3);
  const PointVector points = scan(other_side, scanner, Pose::Identity(), Vector6::Zero(), random);
  return tracker.process(input(points, 20)).T_map_base_mid.translation().norm();
}

TEST(ScanToMap, AWallsOtherSideDoesNotDrawThePose) {
  MatcherConfig one_gate;  // as after a rotation in which the prediction was 0.1 m off
  one_gate.min_gate_m = one_gate.max_gate_m = 0.5;
  MatcherConfig two_gates = one_gate;
  one_gate.fine_gate_m = one_gate.fine_kernel_m = 1.0;
  EXPECT_GT(drawn_by_a_walls_other_side_m(one_gate), 0.015);
  EXPECT_LT(drawn_by_a_walls_other_side_m(two_gates), 0.003);
}

// After a gap, the prediction's error may exceed the fine gate.
TEST(ScanToMap, AfterAGapItIsFoundFromFarther) {
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  drive(tracker, Room{}, scanner, Vector6::Zero(), 0, 18);
  std::mt19937 random(3);
  const Pose T_room_start = pose_from_xyz_rpy_deg({0.3, -0.1, 0.05}, {0, 0, 1});
  const PointVector points = scan(Room{}, scanner, T_room_start, Vector6::Zero(), random);
  tracker.forget_motion();
  const MotionPrediction odometry = true_motion(Pose::Identity(), Vector6::Zero(), 0.1, 1e-2);
  const ScanToMapResult result = tracker.process(input(points, 40), odometry);
  EXPECT_LT(distance_m(result.T_map_base_mid, T_room_start), 0.01);
}

// However small its covariance, a prediction beside the motion of the sweep before changes only
// where the solver starts, not its result: the prediction comes from the same points.
TEST(ScanToMap, APredictionBesideTheMotionBeforeIsAStartOnly) {
  Scanner scanner;
  scanner.noise_m = 0.02;
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  drive(tracker, Room{}, scanner, Vector6::Zero(), 0, 18);
  std::mt19937 random(3);
  const PointVector points = scan(Room{}, scanner, Pose::Identity(), Vector6::Zero(), random);
  const SweepInput sweep = input(points, 20);
  const Pose alone = tracker.match(sweep).T_map_base_mid;
  const Pose T_wrong = pose_from_xyz_rpy_deg({0, 0, 0}, {0, 0, 1});
  MotionPrediction turn = true_motion(T_wrong, Vector6::Zero(), 1e-9, 1e-2);
  turn.use = PredictionUse::kInstead;
  EXPECT_GT(angle_rad(tracker.match(sweep, turn).T_map_base_mid, alone), 0.01);
  turn.use = PredictionUse::kBeside;
  EXPECT_LT(angle_rad(tracker.match(sweep, turn).T_map_base_mid, alone), 1e-4);
  EXPECT_LT(distance_m(tracker.match(sweep, turn).T_map_base_mid, alone), 1e-3);
}

TEST(ScanToMap, AGapOfSweepsIsBridged) {
  const Vector6 v = twist(0.6, 0, 0, 0, 0, 0.3);
  ScanToMap tracker{exact(), MatcherConfig{}};
  std::mt19937 random(1);
  Pose T_start = Pose::Identity();
  for (int k = 0; k < 24; ++k) {
    const Vector6 now = std::min(1.0, k / 10.0) * v;
    if (k < 16 || k > 18) {  // three sweeps lost
      const PointVector points = scan(Room{}, Scanner{}, T_start, now, random);
      const ScanToMapResult result = tracker.process(input(points, k));
      EXPECT_EQ(result.outcome, k == 0 ? Outcome::kStarted : Outcome::kMatched);
      EXPECT_LT(distance_m(result.T_map_base_mid, T_start * exp_se3(0.05 * now)), 3e-3) << k;
    }
    T_start = T_start * exp_se3(0.1 * now);
  }
}

TEST(ScanToMap, EmptyAndBadSweepsArePredictedAndLeaveTheMap) {
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  EXPECT_EQ(tracker.process(input({}, 0)).outcome, Outcome::kPredicted);
  const Vector6 v = twist(0.5, 0, 0, 0, 0, 0);
  const Drive d = drive(tracker, Room{}, Scanner{}, v, 6, 4);
  EXPECT_EQ(d.results.front().outcome, Outcome::kStarted);
  const std::size_t voxels = tracker.map().statistics().voxels;

  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Point bad{nan, 1, 1, 0, 0, 0, ReturnType::kStrongest, 0};
  const Point one{1, 2, 0.5f, 0, 10, 0, ReturnType::kStrongest, 0};
  int number = 12;
  Pose last = d.results.back().T_map_base_mid;
  for (const PointVector& points :
       {PointVector{}, PointVector(1000, bad), PointVector{one}, PointVector(20, one)}) {
    const ScanToMapResult r = tracker.process(input(points, number++));
    EXPECT_EQ(r.outcome, Outcome::kPredicted);
    EXPECT_NEAR(distance_m(r.T_map_base_mid, last), 0.05, 0.005);  // goes on at 0.5 m/s
    last = r.T_map_base_mid;
  }
  EXPECT_EQ(tracker.map().statistics().voxels, voxels);
}

std::size_t counted(const VoxelPlaneMap& map) {
  std::vector<SavedVoxel> voxels;
  for (std::size_t i = 0; i < map.roots().size(); ++i) map.save_root(i, voxels);
  std::size_t points = 0;
  for (const SavedVoxel& voxel : voxels) points += voxel.level == 0 ? voxel.count : 0;
  return points;
}

// An HDL-64E's sweep has the points of four of a VLP-16's: at least enough_points of them are used,
// and less than twice as many.
TEST(ScanToMap, ADenseSweepIsThinnedToEnough) {
  Scanner dense;
  dense.rings = 64;
  MatcherConfig matcher;
  matcher.enough_points = 5000;
  matcher.enough_inserted_points = 8000;
  ScanToMap tracker{exact(), matcher};
  const Vector6 v = twist(0.3, 0.0, 0.0, 0.0, 0.0, 0.2);
  const Drive d = drive(tracker, Room{}, dense, v, 10, 0);
  EXPECT_GT(d.results.back().points, 4 * matcher.enough_points);
  EXPECT_GE(d.results.back().tried, matcher.enough_points);
  EXPECT_LT(d.results.back().tried, 2 * matcher.enough_points);
  const std::size_t sweeps = d.results.size();
  EXPECT_GE(counted(tracker.map()), sweeps * matcher.enough_inserted_points);
  EXPECT_LT(counted(tracker.map()), sweeps * 2 * matcher.enough_inserted_points);
  EXPECT_LT(distance_m(d.results.back().T_map_base_mid, d.truth_mid.back()), 1.5e-3);
}

TEST(ScanToMap, ASweepMayComeInTwoParts) {
  ScanToMap whole{exact(), MatcherConfig{}};
  ScanToMap parts{exact(), MatcherConfig{}};
  std::mt19937 random(1);
  for (int k = 0; k < 4; ++k) {
    const PointVector points = scan(Room{}, Scanner{}, Pose::Identity(), Vector6::Zero(), random);
    SweepInput sweep = input(points, k);
    const ScanToMapResult expected = whole.process(sweep);
    sweep.points = PointSpan(points).first(1000);
    sweep.more_points = PointSpan(points).subspan(1000);
    const ScanToMapResult found = parts.process(sweep);
    EXPECT_EQ(found.T_map_base_mid.matrix(), expected.T_map_base_mid.matrix());
    EXPECT_EQ(found.tried, expected.tried);
  }
  EXPECT_EQ(counted(parts.map()), counted(whole.map()));
}

TEST(ScanToMap, AllEqualPointsDoNotCrash) {
  ScanToMap tracker{PlaneMapConfig{}, MatcherConfig{}};
  const Point one{1, 2, 0.5f, 0, 10, 0, ReturnType::kStrongest, 0};
  for (int k = 0; k < 4; ++k) {
    const ScanToMapResult r = tracker.process(input(PointVector(5000, one), k));
    EXPECT_TRUE(r.T_map_base_end.matrix().allFinite());
    EXPECT_TRUE(r.covariance.allFinite());
  }
}

}  // namespace
}  // namespace zloam::plane_map
