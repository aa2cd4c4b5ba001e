#pragma once
// Readings of an inertial sensor.

#include <Eigen/Core>
#include <cstdint>
#include <span>

namespace zloam {

/// One reading, in the sensor's axes: specific force (m/s^2, +g on z at rest) and angular rate
/// (rad/s), after REP 145.
struct ImuReading {
  /// ns since the Unix epoch
  std::int64_t stamp_ns = 0;
  Eigen::Vector3d force_mps2 = Eigen::Vector3d::Zero();
  Eigen::Vector3d rate_radps = Eigen::Vector3d::Zero();
};

/// Readings this long before and after a sweep are attached to it (schemas/sweep.fbs), to tolerate
/// errors of the stamps.
inline constexpr std::int64_t kImuMargin_ns = 30'000'000;

using ImuSpan = std::span<const ImuReading>;

}  // namespace zloam
