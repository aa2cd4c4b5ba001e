#pragma once
// Preintegrates the IMU readings of one sweep.
//
// Gyroscope and accelerometer are integrated in the frame of base_link at the sweep's begin, at the
// readings' own times, piecewise linear (preintegration: Forster et al., On-Manifold
// Preintegration, T-RO 2017, section V, here over a sweep and with velocities as means over it).
// The lever arm of a sensor away from base_link's origin is removed with the measured rotation:
// velocities need no angular acceleration. Conventions of readings: REP 145 (specific force, +g on
// z at rest).

#include <cstdint>
#include <optional>

#include "common/geometry/imu_reading.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::odometry {

/// Errors of the readings, base_link's axes, and the delay of their stamps.
struct ImuErrors {
  Eigen::Vector3d force_mps2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d rate_radps = Eigen::Vector3d::Zero();
  double delay_s = 0.0;
};

/// One sweep; frame base_link at its begin unless stated otherwise. Velocities are integrals of the
/// specific force: gravity is not added.
struct SweepInertia {
  double period_s = 0.0;
  /// rotation vector from begin to end, rad
  Eigen::Vector3d turn_rad = Eigen::Vector3d::Zero();
  /// change of the angular rate within the sweep, rad per sweep
  Eigen::Vector3d bend_rad = Eigen::Vector3d::Zero();
  /// mean velocity minus that at the begin, m/s
  Eigen::Vector3d begin_to_mean_mps = Eigen::Vector3d::Zero();
  /// velocity at the end minus the mean, m/s, frame base_link at the end
  Eigen::Vector3d mean_to_end_mps = Eigen::Vector3d::Zero();
  /// mean specific force, m/s^2, and the same in the frame at the sweep's end
  Eigen::Vector3d mean_force_mps2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean_force_from_end_mps2 = Eigen::Vector3d::Zero();
  /// root mean square of the readings about their own mean, per axis, m/s^2
  double force_spread_mps2 = 0.0;

  /// All fields, to save or restore them.
  template <class Bits>
  void each(Bits& bits) {
    bits(period_s, turn_rad, bend_rad, begin_to_mean_mps, mean_to_end_mps, mean_force_mps2,
         mean_force_from_end_mps2, force_spread_mps2);
  }
};

/// Nothing if the readings do not cover the sweep, or have gaps of more than three of their own
/// periods. Readings ascend in time; those out of order or not finite are skipped.
std::optional<SweepInertia> integrate(ImuSpan readings, std::int64_t stamp_ns,
                                      std::uint32_t period_ns, const Pose& T_base_imu,
                                      const ImuErrors& errors);

}  // namespace zloam::odometry
