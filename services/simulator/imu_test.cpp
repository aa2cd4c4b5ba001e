#include "simulator/imu.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;

Trajectory standing(double roll, double pitch, double yaw) {
  Knot knot = Knot::Zero();
  knot.tail<3>() << yaw, pitch, roll;
  return {std::vector<Knot>(100, knot), 0.02};
}

ImuConfig ideal() {
  ImuConfig config;
  config.gyro = config.accelerometer = {};
  return config;
}

TEST(Imu, ReadsGravityUpwardsAtRest) {
  const Trajectory level = standing(0.0, 0.0, 1.0);
  const ImuReading reading = Imu(level, ideal(), Pose::Identity(), 1).next();
  EXPECT_TRUE(reading.force_m_s2.isApprox(Vector3d(0.0, 0.0, 9.80665), 1e-12));
  EXPECT_LT(reading.rate_rad_s.norm(), 1e-12);
  // Table of attitudes for g = 9.81: roll 15, pitch -25, yaw 40 degrees.
  const double deg = std::numbers::pi / 180.0;
  const Trajectory tilted = standing(15.0 * deg, -25.0 * deg, 40.0 * deg);
  const Vector3d force = Imu(tilted, ideal(), Pose::Identity(), 1).next().force_m_s2;
  EXPECT_TRUE((force * 9.81 / 9.80665).isApprox(Vector3d(4.14589, 2.30113, 8.58793), 1e-5));
}

TEST(Imu, ItsAxesAreTurnedByTheExtrinsics) {
  ImuConfig config = ideal();
  config.T_base_imu = pose_from_xyz_rpy_deg({0.0, 0.0, 0.0}, {90.0, 0.0, 0.0});  // y points up
  const Trajectory level = standing(0.0, 0.0, 0.0);
  const ImuReading reading = Imu(level, config, Pose::Identity(), 1).next();
  EXPECT_TRUE(reading.force_m_s2.isApprox(Vector3d(0.0, 9.80665, 0.0), 1e-12));
}

// A rotation at an increasing rate about the vertical axis through the trajectory's body.
Trajectory spinning(double rate, double growth) {
  std::vector<Knot> knots;
  for (int i = 0; i < 400; ++i) {
    const double t = 0.01 * i;
    Knot knot = Knot::Zero();
    knot[3] = rate * t + 0.5 * growth * t * t;
    knots.push_back(knot);
  }
  return {std::move(knots), 0.01};
}

TEST(Imu, LeverArmAddsCentrifugalAndTangentialForce) {
  const Trajectory trajectory = spinning(0.5, 0.8);
  ImuConfig config = ideal();
  // 0.4 m ahead of the lidar, which itself sits 0.3 m ahead of the base's origin.
  config.T_base_imu = pose_from_xyz_rpy_deg({0.7, 0.0, 0.2}, {0.0, 0.0, 0.0});
  const Pose T_base_body = pose_from_xyz_rpy_deg({0.3, 0.0, 1.0}, {0.0, 0.0, 0.0});
  Imu imu(trajectory, config, T_base_body, 1);
  for (int i = 0; i < 400; ++i) {
    imu.next();
  }
  const ImuReading reading = imu.next();  // at 2 s
  ASSERT_EQ(reading.time_ns, 2'000'000'000);
  const double rate = 0.5 + 0.8 * 2.0;
  EXPECT_NEAR(reading.rate_rad_s.z(), rate, 1e-6);
  EXPECT_NEAR(reading.force_m_s2.x(), -rate * rate * 0.4, 1e-5);
  EXPECT_NEAR(reading.force_m_s2.y(), 0.8 * 0.4, 1e-5);
  EXPECT_NEAR(reading.force_m_s2.z(), kGravity, 1e-9);
}

TEST(Imu, IntegratesToTheTruth) {
  const auto scene = make_scene("handheld", {.seed = 3});
  ImuConfig config = ideal();
  config.rate_hz = 1000.0;
  config.T_base_imu = pose_from_xyz_rpy_deg({-0.2, 0.1, 0.3}, {5.0, -10.0, 70.0});
  const Pose T_base_body = pose_from_xyz_rpy_deg({0.1, 0.0, 0.9}, {0.0, 0.0, 0.0});
  const Pose T_body_imu = T_base_body.inverse() * config.T_base_imu;
  Imu imu(scene->trajectory, config, T_base_body, 1);
  Eigen::Matrix3d R = T_body_imu.linear();
  R = scene->trajectory.at(0.0).T_world_body.linear() * R;
  Vector3d velocity = Vector3d::Zero();  // it stands still at the start
  Vector3d place = (scene->trajectory.at(0.0).T_world_body * T_body_imu).translation();
  ImuReading last = imu.next();
  while (imu.next_time_ns() <= 10'000'000'000) {
    const ImuReading now = imu.next();
    const double dt = 1e-9 * static_cast<double>(now.time_ns - last.time_ns);
    const Vector3d turn = 0.5 * dt * (last.rate_rad_s + now.rate_rad_s);
    const Eigen::Matrix3d R_next = R * Eigen::AngleAxisd(turn.norm(), turn.normalized());
    const Vector3d acceleration =
        0.5 * (R * last.force_m_s2 + R_next * now.force_m_s2) - Vector3d(0.0, 0.0, kGravity);
    place += dt * velocity + 0.5 * dt * dt * acceleration;
    velocity += dt * acceleration;
    R = R_next;
    last = now;
  }
  const Pose truth =
      scene->trajectory.at(1e-9 * static_cast<double>(last.time_ns)).T_world_body * T_body_imu;
  EXPECT_LT((place - truth.translation()).norm(), 0.01);
  EXPECT_LT(Eigen::AngleAxisd(R.transpose() * truth.linear()).angle(), 1e-3);
}

TEST(Imu, NoiseHasTheDensityAskedFor) {
  ImuConfig config = ideal();
  config.gyro.noise = 1e-3;
  config.accelerometer.noise = 2e-2;
  const Trajectory level = standing(0.0, 0.0, 0.0);
  Imu imu(level, config, Pose::Identity(), 7);
  constexpr int kCount = 20000;
  Vector3d gyro = Vector3d::Zero();
  Vector3d force = Vector3d::Zero();
  Vector3d mean = Vector3d::Zero();
  for (int i = 0; i < kCount; ++i) {
    const ImuReading reading = imu.next();
    EXPECT_EQ(reading.gyro_bias, Vector3d::Zero());
    gyro += reading.rate_rad_s.cwiseAbs2() / kCount;
    force += (reading.force_m_s2 - Vector3d(0.0, 0.0, kGravity)).cwiseAbs2() / kCount;
    mean += reading.force_m_s2 / kCount;
  }
  const double root_hz = std::sqrt(200.0);
  for (int axis = 0; axis < 3; ++axis) {  // 1 sigma of such an estimate is 0.5 %
    EXPECT_NEAR(std::sqrt(gyro[axis]) / (1e-3 * root_hz), 1.0, 0.02);
    EXPECT_NEAR(std::sqrt(force[axis]) / (2e-2 * root_hz), 1.0, 0.02);
    EXPECT_NEAR(mean[axis], axis == 2 ? kGravity : 0.0, 4.0 * 2e-2 * root_hz / std::sqrt(kCount));
  }
}

TEST(Imu, BiasIsDrawnOnceAndWanders) {
  ImuConfig config = ideal();
  config.gyro = {0.0, 0.01, 0.002};
  config.accelerometer = {0.0, 0.2, 0.0};
  const Trajectory level = standing(0.0, 0.0, 0.0);
  double start = 0.0;
  double wander = 0.0;
  constexpr int kUnits = 300;
  for (int unit = 0; unit < kUnits; ++unit) {
    Imu imu(level, config, Pose::Identity(), static_cast<std::uint64_t>(unit));
    const ImuReading first = imu.next();
    EXPECT_TRUE(first.rate_rad_s.isApprox(first.gyro_bias, 1e-12));
    for (int i = 1; i < 800; ++i) {
      imu.next();
    }
    const ImuReading last = imu.next();  // 4 s later
    EXPECT_EQ(last.accelerometer_bias, first.accelerometer_bias);
    EXPECT_TRUE(last.rate_rad_s.isApprox(last.gyro_bias, 1e-12));
    start += first.gyro_bias.squaredNorm() / (3.0 * kUnits);
    wander += (last.gyro_bias - first.gyro_bias).squaredNorm() / (3.0 * kUnits);
  }
  EXPECT_NEAR(std::sqrt(start) / 0.01, 1.0, 0.1);  // 4 sigma of 900 draws
  EXPECT_NEAR(std::sqrt(wander) / (0.002 * std::sqrt(4.0)), 1.0, 0.1);
}

TEST(Imu, SameSeedSameReadings) {
  const Trajectory level = standing(0.0, 0.0, 0.0);
  const auto third = [&](std::uint64_t seed) {
    Imu imu(level, {}, Pose::Identity(), seed);
    imu.next();
    imu.next();
    EXPECT_EQ(imu.next_time_ns(), 10'000'000);
    return imu.next().force_m_s2;
  };
  EXPECT_EQ(third(1), third(1));
  EXPECT_NE(third(1), third(2));
}

TEST(Imu, RefusesImpossibleSettings) {
  const Trajectory level = standing(0.0, 0.0, 0.0);
  ImuConfig config;
  config.gyro.walk = -1.0;
  EXPECT_THROW(Imu(level, config, Pose::Identity(), 1), std::invalid_argument);
  config = {};
  config.rate_hz = 0.0;
  EXPECT_THROW(Imu(level, config, Pose::Identity(), 1), std::invalid_argument);
}

}  // namespace
}  // namespace zloam::simulator
