#pragma once
// The virtual IMU: specific force and angular rate on a trajectory, with white noise, a constant
// bias and a bias that is a random walk. Conventions after REP 145: right-handed, x forward, y
// left, z up, +g on z at rest.

#include <Eigen/Core>
#include <cstdint>

#include "common/geometry/se3.hpp"
#include "simulator/random.hpp"
#include "simulator/trajectory.hpp"

namespace zloam::simulator {

inline constexpr double kGravity = 9.80665;  ///< m/s^2

/// Errors of the gyro or the accelerometer, the same for its three axes. Unit u: rad/s for the
/// gyro, m/s^2 for the accelerometer. The model is that of IEEE Std 952 for Allan variances.
struct ImuErrors {
  double noise = 0.0;  ///< density of the white noise, u/sqrt(Hz)
  double bias = 0.0;   ///< 1 sigma of the constant bias, drawn once, u
  double walk = 0.0;   ///< random walk of the bias, u/sqrt(s)
};

/// The defaults are those of a MEMS IMU common on robots (Xsens MTi-10: 0.03 deg/s/sqrt(Hz),
/// 60 ug/sqrt(Hz)).
struct ImuConfig {
  double rate_hz = 200.0;
  ImuErrors gyro{5e-4, 3e-3, 2e-5};
  ImuErrors accelerometer{6e-4, 2e-2, 1e-4};
  /// Pose of the IMU in base_link; its translation is the lever arm.
  Pose T_base_imu = Pose::Identity();
};

struct ImuReading {
  std::int64_t time_ns = 0;            ///< after the start
  Eigen::Vector3d rate_rad_s;          ///< sensor's axes
  Eigen::Vector3d force_m_s2;          ///< sensor's axes
  Eigen::Vector3d gyro_bias;           ///< bias contained in rate_rad_s
  Eigen::Vector3d accelerometer_bias;  ///< bias contained in force_m_s2
};

/// Reading of an ideal IMU. T_body_imu: its pose in the body frame of the trajectory.
struct IdealInertia {
  Eigen::Vector3d rate_rad_s;
  Eigen::Vector3d force_m_s2;
};
IdealInertia ideal_inertia(const MotionState& state, const Pose& T_body_imu);

/// Yields the readings in order from the start. They depend only on trajectory, configuration and
/// seed.
class Imu {
 public:
  /// T_base_body: pose in base_link of the trajectory's body, whose origin is that of the lidar.
  /// Throws std::invalid_argument if an error setting is negative or the rate is not positive. The
  /// trajectory must outlive this object.
  Imu(const Trajectory& trajectory, const ImuConfig& config, const Pose& T_base_body,
      std::uint64_t seed);

  /// Time of the reading that next() will return, ns after the start.
  std::int64_t next_time_ns() const;
  ImuReading next();

 private:
  Eigen::Vector3d draw(double sigma);

  const Trajectory& trajectory_;
  ImuConfig config_;
  Pose T_body_imu_;
  Random random_;
  std::int64_t count_ = 0;
  Eigen::Vector3d gyro_bias_;
  Eigen::Vector3d accelerometer_bias_;
};

}  // namespace zloam::simulator
