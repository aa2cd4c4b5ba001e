#pragma once
// Poses of a straight drive at 5 m/s with ten sweeps a second, and corrections of them, for the
// tests.

#include <cstdint>

#include "integration/integration.hpp"

namespace zloam::integration::test {

inline Pose along(double x, double yaw_deg = 0.0) {
  return pose_from_xyz_rpy_deg({x, 0.0, 0.0}, {0.0, 0.0, yaw_deg});
}

inline OdometryPose odometry(std::uint64_t sweep, bool replay, std::uint32_t epoch = 0) {
  OdometryPose pose;
  pose.sweep = sweep;
  pose.instant_ns = static_cast<std::int64_t>(sweep + 1) * 100'000'000;
  pose.odom_epoch = epoch;
  pose.T_odom_base = along(0.5 * static_cast<double>(sweep));
  pose.twist_per_s << 5.0, 0, 0, 0, 0, 0;
  pose.step_covariance = 1e-4 * Matrix6::Identity();
  pose.replay = replay;
  return pose;
}

inline Correction correction(std::uint64_t sweep, const Pose& T_map_odom, std::uint32_t epoch = 0) {
  Correction c;
  c.sweep = sweep;
  c.odom_epoch = epoch;
  c.T_map_odom = T_map_odom;
  c.covariance = 4e-4 * Matrix6::Identity();
  return c;
}

}  // namespace zloam::integration::test
