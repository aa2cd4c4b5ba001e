#pragma once
// Predicts a sweep's motion before it is matched, by continuing the motion before and from an
// IMU.

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "odometry/config.hpp"
#include "odometry/inertial_aid.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

/// A change of the twist from one sweep to the next, m/s^2 and rad/s^2.
struct Acceleration {
  Vector6 measured;
  Vector6 sure;  ///< the part beyond the errors of both twists
};

/// The state of the motion after the sweeps before.
struct MotionMemory {
  bool started = false;
  std::int64_t prev_instant_ns = 0;
  double prev_period_s = 0.1;
  Pose T_odom_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  bool twist_known = false;
  std::optional<Matrix12> state_covariance = {};  ///< of both
  Vector6 twist_change_per_s = Vector6::Zero();
  int predicted_in_row = 0;
  /// Of the last kAccelerations sweeps, as many as restore() receives; nothing where it was not
  /// measured.
  std::deque<std::optional<Acceleration>> accelerations;
};
inline constexpr std::size_t kAccelerations = 10;

struct SweepTime {
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 0;
};

struct Prediction {
  MotionState state;
  MotionPrior prior;
  /// States to start matching from, `state` first: the platform may have rotated faster or slower
  /// by more than the matching converges from.
  std::vector<MotionState> starts;
};

/// Continues the motion before.
Prediction predict(const MotionMemory& before, const SweepTime& sweep,
                   const OdometryConfig& config);
/// The same with the IMU's preintegrated motion of the sweep.
Prediction foresee(const MotionMemory& before, const SweepTime& sweep, const OdometryConfig& config,
                   InertialAid& inertial);

/// Such starts about all three axes.
std::vector<MotionState> turned_starts(const MotionMemory& before, const SweepTime& sweep,
                                       const OdometryConfig& config, const MotionState& predicted);

/// One sigma of the change of a known twist, mean over period_s, within over_s.
Vector6 moving_twist_sigma(const MotionMemory& before, const OdometryConfig& config,
                           double period_s, double over_s);

/// One sigma for each translation and one for each rotation.
Vector6 sigmas(double translation, double rotation);

}  // namespace zloam::odometry
