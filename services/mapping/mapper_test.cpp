#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "mapping/mapping.hpp"
#include "mapping/test_room.hpp"

namespace zloam::mapping {
namespace {

using test::Room;
using test::Scan;

Pose at(double x, double y, double z, double yaw_deg = 0.0, double pitch_deg = 0.0) {
  return pose_from_xyz_rpy_deg({x, y, z}, {0.0, pitch_deg, yaw_deg});
}

MappingInput input_of(std::uint64_t sweep, const Scan& scan, const Pose& T_odom_base) {
  MappingInput input;
  input.sweep = sweep;
  input.stamp_ns = static_cast<std::int64_t>(sweep) * 100'000'000;
  input.instant_ns = 100'000'000;
  input.period_ns = 100'000'000;
  input.T_odom_base = T_odom_base;
  input.edges = scan.edges;
  input.planes = scan.planes;
  return input;
}

// Drives through the room with exact odometry; truth(i) is the pose in the map.
struct Drive {
  Room room = test::furnished_room();
  double noise_m = 0.0;
  unsigned seed = 1;
  double plane_gap_m = 0.2;

  template <typename Truth>
  void map(Mapper& mapper, int sweeps, Truth truth) const {
    for (int i = 0; i < sweeps; ++i) {
      const Scan s =
          test::scan(room, truth(i), noise_m, seed + static_cast<unsigned>(i), 60.0, plane_gap_m);
      MappingInput input = input_of(static_cast<std::uint64_t>(i), s, truth(i));
      if (i > 0) input.twist_per_s = 10.0 * log_se3(truth(i - 1).inverse() * truth(i));
      mapper.process(input);
    }
  }
};

Pose small_steps(int i) { return at(0.02 * i, 0.01 * i, 0.002 * i, 0.4 * i); }

struct Offset {
  const char* name;
  Vector6 twist;
};

class RecoversPose : public testing::TestWithParam<Offset> {};

TEST_P(RecoversPose, NoiseFree) {
  Mapper mapper{MappingConfig{}};
  const Drive drive;
  drive.map(mapper, 20, small_steps);
  const Pose truth = small_steps(21);
  const Scan s = test::scan(drive.room, truth, 0.0, 99);
  const MappingResult result = mapper.process(input_of(20, s, truth * exp_se3(GetParam().twist)));
  const Vector6 error = log_se3(truth.inverse() * result.T_map_base);
  EXPECT_EQ(result.health, Health::kOk) << result.reason;
  EXPECT_LT(error.head<3>().norm(), 0.015);
  EXPECT_LT(error.tail<3>().norm(), 0.005);
  EXPECT_TRUE(
      result.T_map_base.isApprox(result.T_map_odom * (truth * exp_se3(GetParam().twist)), 1e-9));
}

TEST_P(RecoversPose, AtTwentyMillimetresOfNoise) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.noise_m = 0.02;
  drive.map(mapper, 20, small_steps);
  const Pose truth = small_steps(21);
  const Scan s = test::scan(drive.room, truth, 0.02, 99);
  const MappingResult result = mapper.process(input_of(20, s, truth * exp_se3(GetParam().twist)));
  const Vector6 error = log_se3(truth.inverse() * result.T_map_base);
  EXPECT_LT(error.head<3>().norm(), 0.02);
  EXPECT_LT(error.tail<3>().norm(), 0.006);
  // The covariance is neither overconfident nor far too wide.
  const double nees = error.dot(result.covariance.inverse() * error) / 6.0;
  EXPECT_LT(nees, 20.0);
  EXPECT_LT(std::sqrt(result.covariance(0, 0)), 0.02);
}

Vector6 twist(double x, double y, double z, double rx, double ry, double rz) {
  Vector6 t;
  t << x, y, z, rx, ry, rz;
  return t;
}

INSTANTIATE_TEST_SUITE_P(
    EachAxis, RecoversPose,
    testing::Values(Offset{"none", Vector6::Zero()}, Offset{"x", twist(0.08, 0, 0, 0, 0, 0)},
                    Offset{"y", twist(0, -0.08, 0, 0, 0, 0)},
                    Offset{"z", twist(0, 0, 0.08, 0, 0, 0)},
                    Offset{"roll", twist(0, 0, 0, 0.015, 0, 0)},
                    Offset{"pitch", twist(0, 0, 0, 0, -0.015, 0)},
                    Offset{"yaw", twist(0, 0, 0, 0, 0, 0.02)},
                    Offset{"all", twist(0.05, 0.04, -0.03, 0.008, 0.008, -0.01)}),
    [](const auto& which) { return which.param.name; });

// Odometry drifts by about 6 mm and 0.5 mrad a sweep: the map corrects the drift.
TEST(Mapper, CorrectsDrift) {
  Mapper mapper{MappingConfig{}};
  const Room room = test::furnished_room();
  const Pose drift = exp_se3(twist(0.005, -0.003, 0.002, 0.0002, 0, 0.0005));
  Pose T_odom_base = small_steps(0);
  double worst_m = 0.0;
  for (int i = 0; i < 60; ++i) {
    const Scan s = test::scan(room, small_steps(i), 0.02, static_cast<unsigned>(i));
    const auto result = mapper.process(input_of(static_cast<std::uint64_t>(i), s, T_odom_base));
    worst_m =
        std::max(worst_m, (result.T_map_base.translation() - small_steps(i).translation()).norm());
    T_odom_base = T_odom_base * (small_steps(i).inverse() * small_steps(i + 1)) * drift;
  }
  EXPECT_GT((T_odom_base.translation() - small_steps(60).translation()).norm(), 0.25);
  EXPECT_LT(worst_m, 0.03);
  EXPECT_EQ(mapper.path().size(), 60U);
}

std::vector<std::uint8_t> bytes_of(const Mapper& mapper) {
  std::vector<std::uint8_t> bytes;
  const auto add = [&bytes](const void* data, std::size_t size) {
    const auto* first = static_cast<const std::uint8_t*>(data);
    bytes.insert(bytes.end(), first, first + size);
  };
  for (const PathPose& p : mapper.path()) add(p.T_map_base.matrix().data(), 16 * sizeof(double));
  for (const LayeredPoint& p : mapper.cloud()) {
    add(&p.point, sizeof p.point);
    bytes.push_back(static_cast<std::uint8_t>(p.layer));
  }
  return bytes;
}

TEST(Mapper, SameInputGivesSameBytes) {
  Drive drive;
  drive.noise_m = 0.02;
  Mapper first{MappingConfig{}};
  Mapper second{MappingConfig{}};
  drive.map(first, 12, small_steps);
  // An allocation between the two runs, so that addresses differ.
  const std::vector<char> elsewhere(1 << 20);
  drive.map(second, 12, small_steps);
  EXPECT_EQ(bytes_of(first), bytes_of(second));
  second.reset();
  drive.map(second, 12, small_steps);
  EXPECT_EQ(bytes_of(first), bytes_of(second)) << "after a reset nothing of the past is left";
}

TEST(Mapper, CorridorsAxisIsFlaggedAndItsErrorCovered) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.room = test::corridor();
  drive.noise_m = 0.02;
  // Only points on faces, none near their edges, so that the axis is unobserved.
  drive.plane_gap_m = 0.7;
  const auto truth = [](int i) { return at(0.05 * i, 0.0, 0.0); };
  drive.map(mapper, 15, truth);
  const Scan s = test::scan(drive.room, truth(15), 0.02, 77, 60.0, drive.plane_gap_m);
  MappingInput input = input_of(15, s, truth(15) * exp_se3(twist(0.10, 0.05, 0, 0, 0, 0.01)));
  input.twist_per_s << 0.5, 0.0, 0.0, 0.0, 0.0, 0.0;
  const MappingResult result = mapper.process(input);
  EXPECT_EQ(result.health, Health::kDegenerate);
  EXPECT_TRUE(result.degeneracy.degenerate);
  EXPECT_GT(std::abs(result.degeneracy.weak_translation.x()), 0.99);
  EXPECT_GT(result.degeneracy.sigma_measured, result.degeneracy.sigma_predicted);
  EXPECT_LT(result.degeneracy.share, 0.01);
  const Eigen::Vector3d error = result.T_map_base.translation() - truth(15).translation();
  EXPECT_LT(std::abs(error.x()), 3.0 * std::sqrt(result.covariance(0, 0)))
      << "the covariance covers it";
  EXPECT_NEAR(error.y(), 0.0, 0.01) << "the walls take the sideways error out";
  EXPECT_GT(result.covariance(0, 0), 4.0 * result.covariance(1, 1));
}

TEST(Mapper, RoomIsNotDegenerate) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.noise_m = 0.02;
  drive.map(mapper, 10, small_steps);
  const Scan s = test::scan(drive.room, small_steps(10), 0.02, 5);
  const auto result = mapper.process(input_of(10, s, small_steps(10)));
  EXPECT_FALSE(result.degeneracy.degenerate);
  EXPECT_GT(result.degeneracy.share, 0.01);
}

TEST(Mapper, BadInputsPassWithAReason) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float inf = std::numeric_limits<float>::infinity();
  const Point zero{};
  Point not_finite = zero;
  not_finite.x = nan;
  Point endless = zero;
  endless.y = inf;
  Point far = zero;
  far.z = 3e30F;
  const std::vector<Scan> bad = {{},
                                 {{zero}, {zero}},
                                 {PointVector(500, not_finite), PointVector(500, endless)},
                                 {PointVector(500, zero), PointVector(5000, zero)},
                                 {PointVector(500, far), PointVector(500, far)}};
  // Without a map, and with one of six sweeps.
  for (const int before : {0, 6}) {
    Mapper mapper{MappingConfig{}};
    const Drive drive;
    drive.map(mapper, before, small_steps);
    auto sweep = static_cast<std::uint64_t>(before);
    for (const Scan& s : bad) {
      const auto result = mapper.process(input_of(sweep++, s, small_steps(before)));
      EXPECT_TRUE(result.T_map_base.isApprox(small_steps(before), 2e-2));
      EXPECT_TRUE(result.covariance.allFinite());
      if (before > 0) {
        EXPECT_FALSE(result.inserted);
        EXPECT_NE(result.health, Health::kOk);
        EXPECT_FALSE(result.reason.empty());
      }
    }
    const Scan good = test::scan(drive.room, small_steps(before), 0.0, 3);
    EXPECT_TRUE(mapper.process(input_of(sweep, good, small_steps(before))).inserted);
  }
}

TEST(Mapper, PoseThatIsNotFiniteIsRefused) {
  Mapper mapper{MappingConfig{}};
  const Drive drive;
  drive.map(mapper, 3, small_steps);
  const Scan s = test::scan(drive.room, small_steps(3), 0.0, 3);
  MappingInput input = input_of(3, s, small_steps(3));
  input.T_odom_base.translation().x() = std::numeric_limits<double>::quiet_NaN();
  const auto result = mapper.process(input);
  EXPECT_EQ(result.health, Health::kInvalid);
  EXPECT_TRUE(result.T_map_base.isApprox(small_steps(2), 1e-2));
  const Health next = mapper.process(input_of(4, s, small_steps(3))).health;
  EXPECT_TRUE(next == Health::kOk || next == Health::kDegenerate);
}

TEST(Mapper, SweepFromElsewhereIsNotInserted) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.noise_m = 0.01;
  drive.map(mapper, 12, small_steps);
  const std::size_t points = mapper.point_count();
  Room other;
  other.hull = {{-30, -3, -4}, {5, 30, 6}};
  const Scan s = test::scan(other, small_steps(12), 0.01, 3);
  const auto result = mapper.process(input_of(12, s, small_steps(12)));
  EXPECT_EQ(result.health, Health::kLost);
  EXPECT_FALSE(result.inserted);
  EXPECT_FALSE(result.reason.empty());
  EXPECT_EQ(mapper.point_count(), points);
  const Scan back = test::scan(drive.room, small_steps(13), 0.01, 4);
  const auto found = mapper.process(input_of(13, back, small_steps(13)));
  EXPECT_EQ(found.health, Health::kOk) << found.reason;
  EXPECT_LT((small_steps(13).inverse() * found.T_map_base).translation().norm(), 0.01);
}

TEST(Mapper, SweepThatFitsFarWorseThanThoseBeforeIsNotInserted) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.noise_m = 0.005;
  drive.map(mapper, 12, small_steps);
  const std::size_t points = mapper.point_count();
  const Scan s = test::scan(drive.room, small_steps(12), 0.06, 3);
  const auto result = mapper.process(input_of(12, s, small_steps(12)));
  EXPECT_GT(result.correspondences, 0U);
  EXPECT_FALSE(result.inserted);
  EXPECT_FALSE(result.reason.empty());
  EXPECT_EQ(mapper.point_count(), points);
}

TEST(Mapper, TilesTellTheirChanges) {
  MappingConfig config;
  config.tile_edge_m = 10.0;
  Mapper mapper{config};
  const Drive drive;
  std::map<TileId, std::uint64_t> version;
  for (int i = 0; i < 4; ++i) {
    const Scan s = test::scan(drive.room, small_steps(i), 0.0, 1);
    const auto result = mapper.process(input_of(static_cast<std::uint64_t>(i), s, small_steps(i)));
    ASSERT_FALSE(result.changed.empty());
    EXPECT_TRUE(std::is_sorted(result.changed.begin(), result.changed.end()));
    for (const TileId& id : result.changed) {
      const auto tile = mapper.tile(id);
      ASSERT_TRUE(tile);
      EXPECT_EQ(tile->version, version[id] + 1);
      version[id] = tile->version;
    }
  }
  std::size_t sum = 0;
  for (const TileId& id : mapper.tiles()) {
    const auto tile = mapper.tile(id);
    sum += tile->points.size();
    for (const MapPoint& p : tile->points) {
      EXPECT_GE(p.x, id.index.i * 10.0 - 1e-4);
      EXPECT_LE(p.x, (id.index.i + 1) * 10.0 + 1e-4);
      EXPECT_GE(p.z, id.index.k * 10.0 - 1e-4);
      EXPECT_LE(p.z, (id.index.k + 1) * 10.0 + 1e-4);
    }
  }
  EXPECT_EQ(sum, mapper.point_count());
  EXPECT_EQ(sum, mapper.cloud().size());
}

// Tiles that leave a small window stay in the whole map, in a file or in memory, and come back.
TEST(Mapper, WindowLosesNothing) {
  for (const bool on_file : {false, true}) {
    MappingConfig config;
    config.tile_edge_m = 5.0;
    config.window_tiles = {5, 5, 3};
    config.local_tiles = {5, 5, 3};
    config.archive_points = on_file ? 0 : 1'000'000;
    config.spill_directory = on_file ? testing::TempDir() : "";
    Mapper mapper{config};
    MappingConfig wide = config;
    wide.window_tiles = {101, 101, 101};
    Mapper reference{wide};
    Drive drive;
    drive.room = test::corridor_with_pillars();
    std::size_t evicted = 0;
    std::map<TileId, std::size_t> largest;
    const auto there_and_back = [](int i) { return at(i < 30 ? i : 60 - i, 0, 0); };
    for (int i = 0; i < 60; ++i) {
      const Scan s = test::scan(drive.room, there_and_back(i), 0.0, 1, 7.0);
      MappingInput input = input_of(static_cast<std::uint64_t>(i), s, there_and_back(i));
      if (i > 0) input.twist_per_s[0] = i < 31 ? 10.0 : -10.0;
      const auto result = mapper.process(input);
      reference.process(input);
      for (const Tile& tile : result.evicted) {
        ++evicted;
        EXPECT_FALSE(tile.points.empty());
        EXPECT_TRUE(mapper.tile(tile.id)) << "still answered after it left";
      }
      for (const TileId& id : mapper.tiles()) {
        const std::size_t now = mapper.tile(id)->points.size();
        // Means of voxels may cross a tile's face; nothing else removes points.
        EXPECT_GE(now + 5, largest[id]);
        largest[id] = std::max(largest[id], now);
      }
    }
    EXPECT_GT(evicted, 5U);
    EXPECT_EQ(mapper.cloud().size(), mapper.point_count());
    EXPECT_NEAR(static_cast<double>(mapper.point_count()),
                static_cast<double>(reference.point_count()),
                0.01 * static_cast<double>(reference.point_count()));
  }
}

TEST(Mapper, BridgesANewOdometryFrame) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.noise_m = 0.01;
  drive.map(mapper, 15, small_steps);
  // The new frame starts at identity 1.2 m and 8 degrees away from where the last pose was.
  const Pose truth = small_steps(15) * exp_se3(twist(1.0, -0.7, 0, 0, 0, 0.14));
  const Scan s = test::scan(drive.room, truth, 0.01, 3);
  MappingInput input = input_of(15, s, Pose::Identity());
  input.odom_epoch = 1;
  const auto result = mapper.process(input);
  // Found, but still Bridging, because the first sweeps of a frame may be distorted.
  EXPECT_EQ(result.health, Health::kBridging) << result.reason;
  EXPECT_FALSE(result.inserted);
  EXPECT_LT((result.T_map_base.translation() - truth.translation()).norm(), 0.03);
  EXPECT_TRUE(result.T_map_odom.isApprox(result.T_map_base, 1e-9));
}

TEST(Mapper, BridgingInsertsNothingUntilItMatches) {
  Mapper mapper{MappingConfig{}};
  Drive drive;
  drive.map(mapper, 15, small_steps);
  const std::size_t points = mapper.point_count();
  Room other;
  other.hull = {{-30, -3, -4}, {5, 30, 6}};
  const Scan s = test::scan(other, Pose::Identity(), 0.01, 3);
  MappingInput input = input_of(15, s, Pose::Identity());
  input.odom_epoch = 1;
  EXPECT_EQ(mapper.process(input).health, Health::kBridging);
  EXPECT_EQ(mapper.point_count(), points);
}

}  // namespace
}  // namespace zloam::mapping
