#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>

#include "drive_file.hpp"
#include "drive_source.hpp"

namespace zloam::search {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;
using std::numbers::pi;

constexpr std::int64_t kSecondNs = 1'000'000'000;

DriveConfig walk_indoors() {
  DriveConfig drive;
  drive.world = "indoor";
  drive.speed_mps = 1.5;
  drive.lateral_mps2 = 0.7;
  drive.height_m = 1.05;
  drive.duration_s = 6.0;
  return drive;
}

class DriveFile : public testing::Test {
 protected:
  ~DriveFile() override { fs::remove_all(folder_); }
  fs::path write(const std::string& text) {
    fs::create_directories(folder_);
    std::ofstream(folder_ / "drive.yaml") << text;
    return folder_ / "drive.yaml";
  }
  fs::path folder_ = fs::temp_directory_path() / ("zloam-drive-" + std::to_string(getpid()));
};

double distance_to_world(const simulator::World& world, const Vector3d& point) {
  double nearest = std::abs(point.z() - world.terrain()->height(point.x(), point.y()));
  for (const simulator::Shape& shape : world.shapes()) {
    nearest = std::min(nearest, simulator::distance_to_surface(point, shape));
  }
  return nearest;
}

// The true pose at a point's own time maps the point onto a surface, so motion, times and angles
// are consistent.
TEST(BeamLidar, PointsLieOnSurfacesFromTheirOwnPoses) {
  DriveConfig drive = walk_indoors();
  drive.waves = {{Axis::kYaw, 1.0, 1.0, 0.3}, {Axis::kRoll, 0.1, 2.0, 0.0}};
  drive.lidar = {.rings = 32, .low_deg = -25.0, .high_deg = 15.0, .columns = 360, .hz = 5.0};
  drive.lidar.noise_m = 0.0;
  const simulator::Scene scene = scene_of(drive);
  const BeamLidar lidar(scene, drive.lidar, 1);
  const Turn turn = lidar.turn(4 * kSecondNs);
  ASSERT_GT(turn.points.size(), 8000U);
  for (std::size_t i = 0; i < turn.points.size(); i += 37) {
    const Point& p = turn.points[i];
    const double time_s = 1e-9 * static_cast<double>(turn.first_ns + p.time_ns);
    const Vector3d at = scene.trajectory.at(time_s).T_world_body * p.position().cast<double>();
    EXPECT_LT(distance_to_world(scene.world, at), 2e-3) << "point " << i;
  }
  EXPECT_GT(turn.points.back().time_ns, 190'000'000U);
}

TEST(BeamLidar, AViewThatIsCutHasNothingElsewhere) {
  DriveConfig drive = walk_indoors();
  drive.lidar.view_deg = 90.0;
  drive.lidar.view_towards_deg = 180.0;
  const simulator::Scene scene = scene_of(drive);
  const Turn turn = BeamLidar(scene, drive.lidar, 1).turn(3 * kSecondNs);
  ASSERT_GT(turn.points.size(), 4000U);
  for (const Point& p : turn.points) EXPECT_LT(p.x, -std::abs(p.y) + 1e-3);
  // The view begins three eighths of a revolution late, and the times count from there.
  EXPECT_NEAR(static_cast<double>(turn.first_ns - 3 * kSecondNs), 37.5e6, 0.1e6);
  EXPECT_EQ(turn.points.front().time_ns, 0U);
}

TEST(BeamLidar, NoiseHasTheSigmaThatWasAskedFor) {
  DriveConfig drive = walk_indoors();
  const simulator::Scene scene = scene_of(drive);
  BeamConfig quiet = drive.lidar, noisy = drive.lidar;
  quiet.noise_m = quiet.dropout = noisy.dropout = 0.0;
  noisy.noise_m = 0.03;
  const Turn a = BeamLidar(scene, quiet, 1).turn(0), b = BeamLidar(scene, noisy, 1).turn(0);
  ASSERT_EQ(a.points.size(), b.points.size());
  double sum = 0.0;
  for (std::size_t i = 0; i < a.points.size(); ++i) {
    const double off = b.points[i].position().norm() - a.points[i].position().norm();
    sum += off * off;
  }
  EXPECT_NEAR(std::sqrt(sum / static_cast<double>(a.points.size())), 0.03, 0.001);
}

// A rosette covers the field of view of its data sheet, each sweep differently, and its points lie
// on surfaces by their own poses.
TEST(BeamLidar, ARosetteFillsItsViewAndDoesNotRepeat) {
  DriveConfig drive = walk_indoors();
  drive.lidar = {.pattern = "mid360"};
  drive.lidar.noise_m = 0.0;
  const simulator::Scene scene = scene_of(drive);
  const BeamLidar lidar(scene, drive.lidar, 1);
  EXPECT_EQ(lidar.rings(), 0);
  const Turn turn = lidar.turn(4 * kSecondNs), next = lidar.turn(4 * kSecondNs + 100'000'000);
  ASSERT_GT(turn.points.size(), 15000U);
  std::vector<int> eighths(8, 0);
  for (std::size_t i = 0; i < turn.points.size(); i += 29) {
    const Point& p = turn.points[i];
    const double time_s = 1e-9 * static_cast<double>(turn.first_ns + p.time_ns);
    const Vector3d at = scene.trajectory.at(time_s).T_world_body * p.position().cast<double>();
    EXPECT_LT(distance_to_world(scene.world, at), 2e-3) << "point " << i;
    const double elevation_deg = std::atan2(p.z, std::hypot(p.x, p.y)) * 180.0 / pi;
    EXPECT_GT(elevation_deg, -7.01);
    EXPECT_LT(elevation_deg, 52.01);
    ++eighths[static_cast<std::size_t>((std::atan2(p.y, p.x) + pi) / (2.0 * pi) * 8.0) % 8];
  }
  for (const int count : eighths) EXPECT_GT(count, 40);
  const auto direction = [](const Point& p) { return p.position().normalized(); };
  EXPECT_GT((direction(turn.points[1000]) - direction(next.points[1000])).norm(), 0.01);
}

TEST(BeamLidar, AnUnknownPatternIsRefused) {
  DriveConfig drive = walk_indoors();
  drive.lidar.pattern = "rose";
  EXPECT_THROW(BeamLidar(scene_of(drive), drive.lidar, 1), std::invalid_argument);
}

TEST(Drive, WavesHaveTheirAmplitude) {
  DriveConfig drive = walk_indoors();
  drive.waves = {{Axis::kRoll, 0.2, 2.0, 0.0}, {Axis::kUp, 0.05, 1.3, 0.0}};
  const DriveConfig smooth = walk_indoors();
  const auto shaken = scene_of(drive).trajectory, still = scene_of(smooth).trajectory;
  double roll = 0.0, up = 0.0;
  for (double t = 3.0; t < 6.0; t += 0.01) {
    const Pose a = shaken.at(t).T_world_body, b = still.at(t).T_world_body;
    roll = std::max(roll, Eigen::AngleAxisd(b.linear().transpose() * a.linear()).angle());
    up = std::max(up, (a.translation() - b.translation()).norm());
  }
  EXPECT_NEAR(roll, 0.2, 0.002);
  EXPECT_NEAR(up, 0.05, 0.0005);
}

TEST(Drive, StandsWhereItStopsAndGoesOn) {
  DriveConfig drive = walk_indoors();
  drive.duration_s = 12.0;
  drive.stops = {{4.0, 2.0, 1.0}};
  const auto trajectory = scene_of(drive).trajectory;
  EXPECT_GT(trajectory.at(3.9).velocity_world.norm(), 0.8);
  for (double t = 5.1; t < 6.9; t += 0.1) EXPECT_LT(trajectory.at(t).velocity_world.norm(), 0.01);
  EXPECT_GT(trajectory.at(8.2).velocity_world.norm(), 0.8);
}

TEST(Drive, VehiclesReachTheirSpeedAndKeepTheirLimits) {
  DriveConfig drive;
  drive.speed_mps = 25.0;
  drive.lateral_mps2 = 5.0;
  drive.acceleration_mps2 = 6.0;
  drive.duration_s = 40.0;
  const simulator::Scene scene = scene_of(drive);
  const Extremes found = extremes(scene, drive);
  EXPECT_GT(found.speed_mps, 20.0);
  EXPECT_LT(found.speed_mps, 25.5);
  EXPECT_LT(found.acceleration_mps2, 12.0);  // longitudinal, lateral, and by the uneven ground
  EXPECT_NO_THROW(require_possible(found, Limits{}));
}

TEST(Drive, ASecondLapBeginsWithoutAJerk) {
  for (const char* world : {"park", "handheld"}) {
    DriveConfig drive;
    drive.world = world;
    drive.speed_mps = world == std::string("park") ? 12.0 : 1.0;
    drive.lateral_mps2 = drive.acceleration_mps2 = 1.0;
    drive.start_share = 0.9;
    drive.duration_s = 40.0;
    const auto trajectory = scene_of(drive).trajectory;
    for (double t = 1.0; t < 40.0; t += 0.002) {
      EXPECT_LT(trajectory.at(t).acceleration_world.head<2>().norm(), 2.5) << world << ' ' << t;
    }
  }
}

TEST(Drive, BeginsElsewhereAndInMotion) {
  DriveConfig drive = walk_indoors();
  drive.start_share = 0.5;
  drive.start_s = 4.0;
  const auto elsewhere = scene_of(drive).trajectory, usual = scene_of(walk_indoors()).trajectory;
  EXPECT_GT(
      (elsewhere.at(0).T_world_body.translation() - usual.at(0).T_world_body.translation()).norm(),
      10.0);
  EXPECT_GT(elsewhere.at(4.0).velocity_world.norm(), 0.5);
}

TEST(Drive, WhatNothingCanDoIsRefused) {
  DriveConfig drive = walk_indoors();
  drive.waves = {{Axis::kUp, 0.3, 4.0, 0.0}};
  EXPECT_THROW(require_possible(extremes(scene_of(drive), drive), Limits{}), std::invalid_argument);
  drive.waves = {{Axis::kSide, 1.5, 0.2, 0.0}};  // through the walls of a corridor
  EXPECT_THROW(require_possible(extremes(scene_of(drive), drive), Limits{}), std::invalid_argument);
}

TEST_F(DriveFile, SweepsThatAreDroppedDoNotCome) {
  const auto path = write(
      "{world: indoor, speed_mps: 1.5, duration_s: 2, height_m: 1.05, dropped: [1, 2, 7],\n"
      " lidar: {columns: 360, rings: 16, hz: 10}}");
  DriveSource source(path);
  driver::DecodedSweep sweep;
  std::vector<std::int64_t> stamps_ns;
  while (source.pull(sweep) == driver::Pull::kSweep) stamps_ns.push_back(sweep.stamp_ns);
  ASSERT_EQ(stamps_ns.size(), 16U);
  EXPECT_NEAR(1e-9 * static_cast<double>(stamps_ns[1] - stamps_ns[0]), 0.3, 1e-3);
}

TEST_F(DriveFile, UnknownKeysAreRefusedByName) {
  for (const auto& [text, key] : {std::pair{"{worlds: city}", "drive.worlds"},
                                  {"{lidar: {beams: 3}}", "lidar.beams"},
                                  {"{waves: [{axis: up, amplitude_deg: 3}]}", "amplitude_deg"},
                                  {"{speed_mps: fast}", "drive.speed_mps"}}) {
    try {
      read_drive(write(text).string());
      ADD_FAILURE() << text;
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(key), std::string::npos) << error.what();
    }
  }
}

}  // namespace
}  // namespace zloam::search
