#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "common/geometry/deskew.hpp"
#include "mapping/mapping.hpp"
#include "mapping/test_room.hpp"
#include "mapping/voxel_planes_method.hpp"

namespace zloam::mapping {
namespace {

constexpr std::uint32_t kPeriod_ns = 100'000'000;

Vector6 twist(double x, double y, double z, double rx, double ry, double rz) {
  Vector6 t;
  t << x, y, z, rx, ry, rz;
  return t;
}

// A sweep of a moving sensor: each column is measured from its own pose, then deskewed to the
// sweep's end with the twist that the odometry estimated.
PointVector swept(const test::Room& room, const Pose& T_map_end, const Vector6& true_twist_per_s,
                  const Vector6& believed_twist_per_s, double noise_m, unsigned seed) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  PointVector points;
  constexpr int kColumns = 900;
  for (int column = 0; column < kColumns; ++column) {
    const auto time_ns = static_cast<std::uint32_t>(column * (kPeriod_ns / kColumns));
    const double since_end_s = 1e-9 * time_ns - 1e-9 * kPeriod_ns;
    const Pose T_map_base = T_map_end * exp_se3(true_twist_per_s * since_end_s);
    for (std::uint16_t ring = 0; ring < 16; ++ring) {
      const double azimuth = -2.0 * M_PI * column / kColumns;
      const double elevation = (-15.0 + 2.0 * ring) * M_PI / 180.0;
      const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                                std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const double range = room.cast(T_map_base.translation(), T_map_base.linear() * ray).first;
      const Eigen::Vector3f p = ((range + noise_m * noise(generator)) * ray).cast<float>();
      points.push_back({p.x(), p.y(), p.z(), 10.0F, time_ns, ring, ReturnType::kStrongest, 0});
    }
  }
  return deskewed(points, DeskewTable(believed_twist_per_s, kPeriod_ns, kPeriod_ns));
}

MappingInput input_of(std::uint64_t sweep, const PointVector& planes, const Pose& T_odom_base,
                      const Vector6& believed_twist_per_s) {
  MappingInput input;
  input.sweep = sweep;
  input.stamp_ns = static_cast<std::int64_t>(sweep * kPeriod_ns);
  input.instant_ns = kPeriod_ns;
  input.period_ns = kPeriod_ns;
  input.T_odom_base = T_odom_base;
  input.twist_per_s = believed_twist_per_s;
  input.planes = planes;
  return input;
}

const Vector6 kMotion = twist(1.5, 0.1, 0.0, 0.0, 0.02, 0.6);

Pose end_of(int sweep) { return exp_se3(0.1 * sweep * kMotion); }

// Odometry's pose and twist have a constant error, which the map's pose must not have.
double worst_error_m(double noise_m, const Vector6& pose_error, const Vector6& twist_error) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  double worst = 0.0;
  for (int i = 0; i < 20; ++i) {
    const Vector6 believed = i == 0 ? Vector6(Vector6::Zero()) : Vector6(kMotion + twist_error);
    const PointVector points = swept(room, end_of(i), kMotion, believed, noise_m, 7U + i);
    const Pose T_odom_base = i == 0 ? end_of(0) : Pose(end_of(i) * exp_se3(pose_error));
    const auto result =
        mapper.process(input_of(static_cast<std::uint64_t>(i), points, T_odom_base, believed));
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_TRUE(result.inserted);
    const Vector6 error = log_se3(end_of(i).inverse() * result.T_map_base);
    if (i > 2) worst = std::max(worst, error.head<3>().norm());
  }
  return worst;
}

TEST(VoxelPlanes, FindsThePoseWithoutNoise) {
  EXPECT_LT(worst_error_m(0.0, Vector6::Zero(), Vector6::Zero()), 0.01);
}

TEST(VoxelPlanes, TakesOutWhatOdometrysDeskewingLeft) {
  const Vector6 pose_error = twist(0.03, -0.02, 0.01, 0.0, 0.0, 0.005);
  const Vector6 twist_error = twist(0.2, -0.1, 0.05, 0.01, 0.0, 0.05);
  EXPECT_LT(worst_error_m(0.01, pose_error, twist_error), 0.02);
}

// A sweep damaged in transit: its positions, its times or both are wrong.
PointVector damaged(PointVector points, double spread_m, bool times, unsigned seed) {
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> place(static_cast<float>(-spread_m),
                                              static_cast<float>(spread_m));
  std::uniform_int_distribution<std::uint32_t> time(0, std::numeric_limits<std::uint32_t>::max());
  for (Point& p : points) {
    if (spread_m > 0.0) p.x += place(generator), p.y += place(generator), p.z += place(generator);
    if (times) p.time_ns = time(generator);
  }
  return points;
}

// One damaged sweep leaves the pose near the odometry's, and the next sweeps are matched.
TEST(VoxelPlanes, OneDamagedSweepMovesNothing) {
  const test::Room room = test::furnished_room();
  for (const double spread_m : {0.0, 1.0, 30.0, 1e3, 1e6}) {
    for (const bool times : {false, true}) {
      SCOPED_TRACE(testing::Message() << spread_m << " m, times " << times);
      Mapper mapper{MappingConfig{}};
      for (int i = 0; i < 14; ++i) {
        PointVector points = swept(room, end_of(i), kMotion, kMotion, 0.01, 7U + i);
        const bool bad = i == 10;
        if (bad) points = damaged(std::move(points), spread_m, times, 5U);
        const auto result =
            mapper.process(input_of(static_cast<std::uint64_t>(i), points, end_of(i), kMotion));
        const Vector6 error = log_se3(end_of(i).inverse() * result.T_map_base);
        EXPECT_LT(error.head<3>().norm(), bad ? 0.5 : 0.03) << "sweep " << i;
        EXPECT_LT(error.tail<3>().norm(), bad ? 0.1 : 0.01) << "sweep " << i;
      }
    }
  }
}

// A new odometry frame lies farther away than the first search reaches; later searches are wider.
TEST(VoxelPlanes, ANewFrameIsSearchedForFurtherOutWithTime) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  const Vector6 rest = Vector6::Zero();
  for (int i = 0; i < 10; ++i) {
    const PointVector points = swept(room, end_of(i), kMotion, kMotion, 0.01, 7U + i);
    mapper.process(input_of(static_cast<std::uint64_t>(i), points, end_of(i), kMotion));
  }
  const Pose truth = end_of(9) * exp_se3(twist(3.5, -2.0, 0.0, 0.0, 0.0, 0.5));
  bool found = false;
  for (std::uint64_t sweep = 10; sweep < 30; ++sweep) {
    const PointVector points = swept(room, truth, rest, rest, 0.01, 7U + sweep);
    MappingInput input = input_of(sweep, points, Pose::Identity(), rest);
    input.odom_epoch = 1;
    const auto result = mapper.process(input);
    found = found || result.health == Health::kOk;
    // Nothing is inserted until the frame is found, and from then on the pose is right.
    EXPECT_TRUE(found || !result.inserted) << sweep;
    const double off_m = (result.T_map_base.translation() - truth.translation()).norm();
    EXPECT_TRUE(!found || off_m < 0.05) << sweep << ": " << off_m;
  }
  EXPECT_TRUE(found);
}

// Ten sweeps did not reach mapping, and the sensor reversed its rotation during them.
TEST(VoxelPlanes, AfterAGapTheOdometryKnowsTheMotion) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  std::uint64_t sweep = 0;
  for (; sweep < 8; ++sweep) {
    const int i = static_cast<int>(sweep);
    const PointVector points = swept(room, end_of(i), kMotion, kMotion, 0.01, 7U + sweep);
    mapper.process(input_of(sweep, points, end_of(i), kMotion));
  }
  const Vector6 other = twist(0.5, 0.0, 0.0, 0.0, 0.0, -0.8);
  for (sweep = 18; sweep < 22; ++sweep) {
    const Pose truth = end_of(7) * exp_se3(0.1 * static_cast<double>(sweep - 7) * other);
    const PointVector points = swept(room, truth, other, other, 0.01, 7U + sweep);
    MappingInput input = input_of(sweep, points, truth, other);
    input.step_covariance = 1e-4 * Matrix6::Identity();
    const auto result = mapper.process(input);
    EXPECT_EQ(result.health, Health::kOk) << result.reason;
    EXPECT_LT((result.T_map_base.translation() - truth.translation()).norm(), 0.03) << sweep;
  }
}

// From one sweep to the next the sensor rotates by a radian: it was jolted, or carried unobserved
// by the odometry. Returns the largest error (m) of the Ok poses after that, and their number.
std::pair<double, int> after_a_jolt(bool seen_by_odometry) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  const Pose jolt = exp_se3(twist(0.3, 0.2, 0.0, 0.0, 0.0, 1.0));
  double worst = 0.0;
  int ok = 0;
  for (int i = 0; i < 12; ++i) {
    const Pose truth = i < 6 ? end_of(i) : Pose(end_of(i) * jolt);
    const PointVector points =
        swept(room, truth, kMotion, kMotion, 0.01, 7U + static_cast<unsigned>(i));
    const Pose T_odom_base = seen_by_odometry ? truth : end_of(i);
    MappingInput input = input_of(static_cast<std::uint64_t>(i), points, T_odom_base, kMotion);
    input.step_covariance = 1e-4 * Matrix6::Identity();
    const MappingResult result = mapper.process(input);
    if (i < 6 || result.health != Health::kOk) continue;
    ++ok;
    worst = std::max(worst, (result.T_map_base.translation() - truth.translation()).norm());
  }
  return {worst, ok};
}

TEST(VoxelPlanes, AJoltIsFoundFromTheOdometrys) {
  const auto [worst_m, ok] = after_a_jolt(true);
  EXPECT_LT(worst_m, 0.05);
  EXPECT_EQ(ok, 6);
}

TEST(VoxelPlanes, AJoltThatNobodySawIsFoundInTheMap) {
  const auto [worst_m, ok] = after_a_jolt(false);
  EXPECT_LT(worst_m, 0.05);
  // Three sweeps must agree, so the first two are not Ok.
  EXPECT_EQ(ok, 4);
}

// Open ground with small boxes, each narrower than the sensor's swing within a sweep.
test::Room thicket() {
  test::Room out{{{-300.0, -300.0, -1.3}, {300.0, 300.0, 100.0}}, {}};
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (int i = 0; i < 200; ++i) {
    const double range = 3.0 + 9.0 * uniform(generator);
    const double azimuth = 2.0 * M_PI * uniform(generator);
    const Eigen::Vector3d low(range * std::cos(azimuth), range * std::sin(azimuth),
                              -1.3 + 2.0 * uniform(generator));
    const double size = 0.1 + 0.3 * uniform(generator);
    out.boxes.push_back({low, low + Eigen::Vector3d::Constant(size)});
  }
  return out;
}

// Largest error of the map's pose with exact odometry. first_believed: the twist that the odometry
// assumes for the first sweep, whose motion it may not know.
double worst_m(const test::Room& room, const std::vector<Vector6>& motions,
               const Vector6& first_believed) {
  Mapper mapper{MappingConfig{}};
  Pose truth = Pose::Identity();
  double worst = 0.0;
  for (std::size_t i = 0; i < motions.size(); ++i) {
    if (i > 0) truth = truth * exp_se3(0.1 * motions[i]);
    const Vector6& believed = i == 0 ? first_believed : motions[i];
    const PointVector points =
        swept(room, truth, motions[i], believed, 0.01, 7U + static_cast<unsigned>(i));
    MappingInput input = input_of(i, points, truth, believed);
    input.step_covariance = 1e-4 * Matrix6::Identity();
    const Pose T_map_base = mapper.process(input).T_map_base;
    worst = std::max(worst, (T_map_base.translation() - truth.translation()).norm());
  }
  return worst;
}

// The sensor swings back and forth; its rotation per sweep changes by up to 0.12 rad from one sweep
// to the next.
double worst_while_swinging_m() {
  std::vector<Vector6> motions;
  for (int i = 0; i < 40; ++i) {
    const double turn_rad = i < 5 ? 0.0 : 0.48 * std::sin(0.25 * (i - 5));
    motions.push_back(twist(0.5, 0.0, 0.0, 0.0, 0.0, 10.0 * turn_rad));
  }
  return worst_m(thicket(), motions, motions.front());
}

TEST(VoxelPlanes, AnUnpredictedTurnIsFoundFromTheOdometrys) {
  EXPECT_LT(worst_while_swinging_m(), 0.06);
}

// Started while rotating, slower from sweep to sweep: the first sweep is re-inserted with the
// motion of the second one, which differs from its own.
double worst_after_a_turning_start_m(const test::Room& room, double turn_rad) {
  std::vector<Vector6> motions;
  for (int i = 0; i < 8; ++i) {
    motions.push_back(twist(0.7, 0.0, 0.0, 0.0, 0.0, 10.0 * turn_rad * std::pow(0.6, i)));
  }
  return worst_m(room, motions, Vector6::Zero());
}

test::Room street() {
  test::Room out{{{-60.0, -9.0, -1.5}, {60.0, 12.0, 40.0}}, {}};
  for (int i = 0; i < 8; ++i) {
    const double x = -50.0 + 13.0 * i;
    out.boxes.push_back({{x, -9.0, -1.5}, {x + 3.0, -8.2, 3.0}});
    out.boxes.push_back({{x + 4.0, 3.0, -1.5}, {x + 8.0, 4.8, 0.0}});
    out.boxes.push_back({{x + 9.0, -4.0, -1.5}, {x + 9.2, -3.8, 4.0}});
  }
  return out;
}

TEST(VoxelPlanes, AStartInATurnIsFollowed) {
  EXPECT_LT(worst_after_a_turning_start_m(street(), 0.25), 0.1);
  EXPECT_LT(worst_after_a_turning_start_m(street(), 0.3), 0.1);
}

// A few ledges give no more information along a corridor than errors of its walls' normals may
// produce.
TEST(VoxelPlanes, SoLittleAlongAnAxisIsDegenerate) {
  test::Room room = test::corridor();
  for (double x = -60.0; x < 60.0; x += 13.1) {
    room.boxes.push_back({{x, -2.0, -1.2}, {x + 0.3, -1.8, 1.8}});
  }
  const Vector6 motion = twist(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
  Mapper mapper{MappingConfig{}};
  for (int i = 0; i < 12; ++i) {
    const Pose truth = exp_se3(0.1 * i * motion);
    const Vector6 believed = i == 0 ? Vector6(Vector6::Zero()) : motion;
    const PointVector points =
        swept(room, truth, motion, believed, 0.01, 7U + static_cast<unsigned>(i));
    MappingInput input = input_of(static_cast<std::uint64_t>(i), points, truth, believed);
    input.step_covariance = 1e-4 * Matrix6::Identity();
    const MappingResult result = mapper.process(input);
    EXPECT_TRUE(i < 6 || result.health == Health::kDegenerate) << i;
    EXPECT_TRUE(i < 6 || std::abs(result.degeneracy.weak_translation.x()) > 0.99) << i;
  }
}

TEST(VoxelPlanes, BridgesANewOdometryFrame) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  const Vector6 still = Vector6::Zero();
  for (int i = 0; i < 8; ++i) {
    const PointVector points = swept(room, Pose::Identity(), still, still, 0.01, 7U + i);
    mapper.process(input_of(static_cast<std::uint64_t>(i), points, Pose::Identity(), still));
  }
  const Pose truth = exp_se3(twist(0.9, -0.6, 0, 0, 0, 0.1));
  const PointVector points = swept(room, truth, still, still, 0.01, 99);
  MappingInput input = input_of(8, points, Pose::Identity(), still);
  input.odom_epoch = 1;
  const auto result = mapper.process(input);
  // Found, but still Bridging, because the first sweeps of a frame may be distorted.
  EXPECT_EQ(result.health, Health::kBridging) << result.reason;
  EXPECT_FALSE(result.inserted);
  EXPECT_LT((result.T_map_base.translation() - truth.translation()).norm(), 0.03);
}

// How far the map's pose moves within ten sweeps over bare ground, which does not constrain
// horizontal motion, if the odometry states a motion with a sigma of 0.15 m per sweep.
double gone_over_bare_ground_m(const Vector6& believed_twist_per_s) {
  Mapper mapper{MappingConfig{}};
  const test::Room yard{{{-300.0, -300.0, -1.5}, {300.0, 300.0, 50.0}}, {}};
  Pose T_map_base = Pose::Identity();
  for (int i = 0; i < 10; ++i) {
    const Vector6 believed = i == 0 ? Vector6(Vector6::Zero()) : believed_twist_per_s;
    PointVector points = swept(yard, Pose::Identity(), Vector6::Zero(), Vector6::Zero(), 0.01,
                               7U + static_cast<unsigned>(i));
    std::erase_if(points, [](const Point& p) { return p.position().norm() > 60.0F; });
    MappingInput input = input_of(static_cast<std::uint64_t>(i), points,
                                  exp_se3(0.1 * i * believed_twist_per_s), believed);
    input.step_covariance.diagonal().setConstant(0.15 * 0.15);
    T_map_base = mapper.process(input).T_map_base;
  }
  return T_map_base.translation().norm();
}

TEST(VoxelPlanes, AFirstMotionWithinItsOwnErrorIsNone) {
  EXPECT_LT(gone_over_bare_ground_m(twist(0.7, 0.7, 0, 0, 0, 0)), 0.1);
}

TEST(VoxelPlanes, AFirstMotionBeyondItsOwnErrorIsTakenUp) {
  EXPECT_NEAR(gone_over_bare_ground_m(twist(7.0, 0.0, 0, 0, 0, 0)), 6.3, 0.7);
}

TEST(VoxelPlanes, OddSweepsArePredictedAndNotInserted) {
  Mapper mapper{MappingConfig{}};
  const test::Room room = test::furnished_room();
  const Vector6 still = Vector6::Zero();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const PointVector good = swept(room, Pose::Identity(), still, still, 0.01, 1);
  const PointVector odd[] = {
      {},
      {{nan, nan, nan, 0, 0, 0, ReturnType::kStrongest, 0}},
      {{1.0F, 2.0F, 3.0F, 0, 0, 0, ReturnType::kStrongest, 0}},
      PointVector(500, {1.0F, 2.0F, 3.0F, 0, 0, 0, ReturnType::kStrongest, 0})};
  std::uint64_t sweep = 0;
  for (int i = 0; i < 4; ++i) {
    mapper.process(input_of(sweep++, good, Pose::Identity(), still));
  }
  for (const PointVector& points : odd) {
    const auto result = mapper.process(input_of(sweep++, points, Pose::Identity(), still));
    EXPECT_TRUE(result.T_map_base.matrix().allFinite());
    EXPECT_LT(result.T_map_base.translation().norm(), 0.05);
    EXPECT_FALSE(result.inserted);
  }
  const auto result = mapper.process(input_of(sweep++, good, Pose::Identity(), still));
  EXPECT_EQ(result.health, Health::kOk);
  EXPECT_LT(result.T_map_base.translation().norm(), 0.02);
}

// An empty cloud in a recording: the next sweep is matched as after one that is missing.
TEST(VoxelPlanes, AnEmptySweepWithoutAPeriodLeavesTheMotion) {
  const test::Room room = test::furnished_room();
  std::vector<Match> last(2);
  for (const bool comes : {false, true}) {
    const auto method = make_voxel_planes_method(MappingConfig{});
    for (int i = 0; i < 8; ++i) {
      const bool empty = i == 6;
      if (empty && !comes) continue;
      PointVector points;
      if (!empty) points = swept(room, end_of(i), kMotion, kMotion, 0.01, 7U + i);
      MappingInput input = input_of(static_cast<std::uint64_t>(i), points, end_of(i), kMotion);
      if (empty) input.period_ns = 0;
      const Match match = method->match(input, {end_of(i), 1e-4 * Matrix6::Identity()});
      EXPECT_EQ(match.ok, i > 0 && !empty) << i;
      if (!empty) method->insert(input, match);
      last[comes ? 1U : 0U] = match;
    }
  }
  EXPECT_EQ(last[0].T_map_base.matrix(), last[1].T_map_base.matrix());
  EXPECT_EQ(last[0].covariance, last[1].covariance);
}

}  // namespace
}  // namespace zloam::mapping
