#pragma once
// The motion of the platform: a pose for every instant, twice continuously differentiable.

#include <Eigen/Core>
#include <vector>

#include "common/geometry/se3.hpp"
#include "simulator/cubic_spline.hpp"

namespace zloam::simulator {

/// Pose and motion at one instant.
struct MotionState {
  Pose T_world_body = Pose::Identity();
  Eigen::Vector3d velocity_world = Eigen::Vector3d::Zero();             ///< m/s
  Eigen::Vector3d acceleration_world = Eigen::Vector3d::Zero();         ///< m/s^2, without gravity
  Eigen::Vector3d rate_body = Eigen::Vector3d::Zero();                  ///< rad/s, body axes
  Eigen::Vector3d angular_acceleration_body = Eigen::Vector3d::Zero();  ///< rad/s^2, body axes
};

/// A knot of a trajectory: x, y, z (m), yaw, pitch, roll (rad; R = Rz(yaw) Ry(pitch) Rx(roll)). Yaw
/// is not wrapped.
using Knot = Eigen::Matrix<double, 6, 1>;

class Trajectory {
 public:
  Trajectory() = default;
  /// Knots at i * step_s; at least two.
  Trajectory(std::vector<Knot> knots, double step_s) : spline_(std::move(knots), step_s) {}

  double duration_s() const { return spline_.end(); }

  /// State at a time after the start (s); before 0 and after the end the platform stands still.
  MotionState at(double time_s) const;

 private:
  CubicSpline<6> spline_;
};

}  // namespace zloam::simulator
