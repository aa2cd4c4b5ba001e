#pragma once
// What is known of a sweep's motion before it is looked at: the motion before carried on, and what
// an inertial sensor foretells.

#include <cstdint>
#include <optional>

#include "odometry/config.hpp"
#include "odometry/inertial_aid.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

/// What the sweeps before left behind of the motion.
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
};

struct SweepTime {
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 0;
};

struct Prediction {
  MotionState state;
  MotionPrior prior;
};

/// The motion before, carried on.
Prediction predict(const MotionMemory& before, const SweepTime& sweep,
                   const OdometryConfig& config);
/// The same with what the inertial sensor felt of the sweep.
Prediction foresee(const MotionMemory& before, const SweepTime& sweep, const OdometryConfig& config,
                   InertialAid& inertial);

/// What a known twist, over a period, may have changed by over a time.
Vector6 moving_twist_sigma(const OdometryConfig& config, double period_s, double over_s);

/// The same for each translation and for each rotation.
Vector6 sigmas(double translation, double rotation);

}  // namespace zloam::odometry
