#pragma once
// The virtual inertial sensor: specific force and angular rate on a trajectory, with white noise, a
// constant bias and one that wanders. Conventions after REP 145: right-handed, x forward, y left, z
// up, +g on z at rest.

#include <Eigen/Core>
#include <cstdint>

#include "common/geometry/se3.hpp"
#include "simulator/random.hpp"
#include "simulator/trajectory.hpp"

namespace zloam::simulator {

inline constexpr double kGravity = 9.80665;  ///< m/s^2

/// Errors of one kind of measurement, the same for its three axes. Units: u is rad/s for the gyro,
/// m/s^2 for the accelerometer. Model: IEEE Std 952, as allan variances are read.
struct ImuErrors {
  double noise = 0.0;  ///< density of the white noise, u/sqrt(Hz)
  double bias = 0.0;   ///< 1 sigma of the constant bias, drawn once, u
  double walk = 0.0;   ///< random walk of the bias, u/sqrt(s)
};

/// Defaults: a MEMS unit of the class that robots carry (Xsens MTi-10: 0.03 deg/s/sqrt(Hz), 60
/// ug/sqrt(Hz)).
struct ImuConfig {
  double rate_hz = 200.0;
  ImuErrors gyro{5e-4, 3e-3, 2e-5};
  ImuErrors accelerometer{6e-4, 2e-2, 1e-4};
  /// Carries vectors of the sensor into the base; its place gives the lever arm.
  Pose T_base_imu = Pose::Identity();
};

struct ImuReading {
  std::int64_t time_ns = 0;            ///< after the start
  Eigen::Vector3d rate_rad_s;          ///< sensor's axes
  Eigen::Vector3d force_m_s2;          ///< sensor's axes
  Eigen::Vector3d gyro_bias;           ///< what of rate_rad_s is bias
  Eigen::Vector3d accelerometer_bias;  ///< what of force_m_s2 is bias
};

/// What an ideal sensor would read. T_body_imu: its pose against the body of the trajectory.
struct IdealInertia {
  Eigen::Vector3d rate_rad_s;
  Eigen::Vector3d force_m_s2;
};
IdealInertia ideal_inertia(const MotionState& state, const Pose& T_body_imu);

/// Readings one after the other, from the start; a function of trajectory, configuration and seed.
class Imu {
 public:
  /// T_base_body: the trajectory's body in the base, that is where the lidar sits. Throws
  /// std::invalid_argument for settings below 0 and for a rate that is not above 0. The trajectory
  /// must outlive this object.
  Imu(const Trajectory& trajectory, const ImuConfig& config, const Pose& T_base_body,
      std::uint64_t seed);

  /// Time of the reading that next() will give, ns after the start.
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
