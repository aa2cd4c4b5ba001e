#include "simulator/trajectory.hpp"

#include <cmath>

namespace zloam::simulator {

MotionState Trajectory::at(double time_s) const {
  const auto sample = spline_.at(time_s);
  const double cy = std::cos(sample.value[3]);
  const double sy = std::sin(sample.value[3]);
  const double cp = std::cos(sample.value[4]);
  const double sp = std::sin(sample.value[4]);
  const double cr = std::cos(sample.value[5]);
  const double sr = std::sin(sample.value[5]);
  MotionState state;
  state.T_world_body.linear() << cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,  //
      sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,                             //
      -sp, cp * sr, cp * cr;
  state.T_world_body.translation() = sample.value.head<3>();
  state.velocity_world = sample.first.head<3>();
  state.acceleration_world = sample.second.head<3>();
  const double yaw_rate = sample.first[3];
  const double pitch_rate = sample.first[4];
  const double roll_rate = sample.first[5];
  state.rate_body = {roll_rate - yaw_rate * sp, pitch_rate * cr + yaw_rate * cp * sr,
                     -pitch_rate * sr + yaw_rate * cp * cr};
  // Derivative of rate_body, term by term.
  const Eigen::Vector3d second = sample.second.tail<3>();  // second derivatives: yaw, pitch, roll
  const double yaw_part = second[0] * cp - yaw_rate * pitch_rate * sp;
  state.angular_acceleration_body = {
      second[2] - second[0] * sp - yaw_rate * pitch_rate * cp,
      second[1] * cr + yaw_part * sr + roll_rate * state.rate_body.z(),
      -second[1] * sr + yaw_part * cr - roll_rate * state.rate_body.y()};
  return state;
}

}  // namespace zloam::simulator
