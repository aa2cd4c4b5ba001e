#pragma once
// Readings of an ideal IMU along a motion, for the tests: by finite differences of the motion.

#include <cmath>
#include <vector>

#include "common/geometry/imu_reading.hpp"
#include "odometry/test_room.hpp"

namespace zloam::odometry {

struct TestImu {
  Pose T_base_imu = Pose::Identity();
  double rate_hz = 200.0;
  Eigen::Vector3d gravity_world_mps2{0.0, 0.0, -9.80665};
  Eigen::Vector3d force_bias_mps2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d rate_bias_radps = Eigen::Vector3d::Zero();
  double force_noise_mps2 = 0.0;
  double rate_noise_radps = 0.0;
  /// of the stamps
  double delay_s = 0.0;
};

/// Readings from a time to another; stamps are origin_ns + the time.
inline std::vector<ImuReading> readings_along(const Motion& motion, const TestImu& imu,
                                              double from_s, double to_s, std::int64_t origin_ns) {
  constexpr double kStep_s = 2e-4;
  std::vector<ImuReading> readings;
  const auto first = static_cast<int>(std::ceil(from_s * imu.rate_hz));
  const auto last = static_cast<int>(std::floor(to_s * imu.rate_hz));
  for (int i = first; i <= last; ++i) {
    const double t = i / imu.rate_hz;
    const auto at = [&](double time_s) { return motion(time_s) * imu.T_base_imu; };
    const Pose before = at(t - kStep_s), now = at(t), after = at(t + kStep_s);
    const Eigen::Vector3d acceleration =
        (before.translation() - 2.0 * now.translation() + after.translation()) /
        (kStep_s * kStep_s);
    // Drawn by the reading's own number: overlapping spans hold the same readings.
    std::mt19937 rng(static_cast<unsigned>(i));
    std::normal_distribution<double> noise(0.0, 1.0);
    const auto draw = [&](double sigma) {
      return Eigen::Vector3d(sigma * noise(rng), sigma * noise(rng), sigma * noise(rng));
    };
    ImuReading r;
    r.stamp_ns = origin_ns + std::llround(1e9 * (t + imu.delay_s));
    r.force_mps2 = now.linear().transpose() * (acceleration - imu.gravity_world_mps2) +
                   imu.force_bias_mps2 + draw(imu.force_noise_mps2);
    r.rate_radps = log_so3(before.linear().transpose() * after.linear()) / (2.0 * kStep_s) +
                   imu.rate_bias_radps + draw(imu.rate_noise_radps);
    readings.push_back(r);
  }
  return readings;
}

/// A platform that swings and bobs about every axis.
inline Pose swinging(double t) {
  Pose at = Pose::Identity();
  at.linear() = exp_so3({0.0, 0.0, 0.8 * std::sin(1.3 * t)}) *
                exp_so3({0.15 * std::sin(4.1 * t), 0.2 * std::cos(3.3 * t), 0.0});
  at.translation() << 0.9 * std::sin(1.7 * t), 0.6 * std::cos(2.3 * t), 0.2 * std::sin(5.0 * t);
  return at;
}

}  // namespace zloam::odometry
