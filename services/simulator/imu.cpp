#include "simulator/imu.hpp"

#include <cmath>
#include <stdexcept>

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;

void check(const ImuErrors& errors) {
  if (!(errors.noise >= 0.0 && errors.bias >= 0.0 && errors.walk >= 0.0)) {
    throw std::invalid_argument("noise, bias and walk of the IMU must not be negative");
  }
}

}  // namespace

IdealInertia ideal_inertia(const MotionState& state, const Pose& T_body_imu) {
  const Vector3d& rate = state.rate_body;
  const Vector3d lever = T_body_imu.translation();
  // Specific force at the body's origin, plus the tangential and the centripetal acceleration at
  // the end of the lever arm.
  const Vector3d force = state.T_world_body.linear().transpose() *
                             (state.acceleration_world + Vector3d(0.0, 0.0, kGravity)) +
                         state.angular_acceleration_body.cross(lever) +
                         rate.cross(rate.cross(lever));
  const Eigen::Matrix3d R_imu_body = T_body_imu.linear().transpose();
  return {R_imu_body * rate, R_imu_body * force};
}

Imu::Imu(const Trajectory& trajectory, const ImuConfig& config, const Pose& T_base_body,
         std::uint64_t seed)
    : trajectory_(trajectory),
      config_(config),
      T_body_imu_(T_base_body.inverse() * config.T_base_imu),
      random_(seed, Stream::kImu) {
  check(config.gyro);
  check(config.accelerometer);
  if (!(config.rate_hz > 0.0)) {
    throw std::invalid_argument("the rate of the IMU must be above 0");
  }
  gyro_bias_ = draw(config.gyro.bias);
  accelerometer_bias_ = draw(config.accelerometer.bias);
}

// Axis by axis, because C++ does not specify the order in which the arguments of a constructor are
// evaluated.
Vector3d Imu::draw(double sigma) {
  Vector3d out;
  for (int axis = 0; axis < 3; ++axis) {
    out[axis] = sigma * random_.normal();
  }
  return out;
}

std::int64_t Imu::next_time_ns() const {
  return std::llround(static_cast<double>(count_) * 1e9 / config_.rate_hz);
}

ImuReading Imu::next() {
  const std::int64_t time_ns = next_time_ns();
  const IdealInertia ideal =
      ideal_inertia(trajectory_.at(static_cast<double>(time_ns) * 1e-9), T_body_imu_);
  const double root_hz = std::sqrt(config_.rate_hz);
  ImuReading reading;
  reading.time_ns = time_ns;
  reading.gyro_bias = gyro_bias_;
  reading.accelerometer_bias = accelerometer_bias_;
  reading.rate_rad_s = ideal.rate_rad_s + gyro_bias_ + draw(config_.gyro.noise * root_hz);
  reading.force_m_s2 =
      ideal.force_m_s2 + accelerometer_bias_ + draw(config_.accelerometer.noise * root_hz);
  gyro_bias_ += draw(config_.gyro.walk / root_hz);
  accelerometer_bias_ += draw(config_.accelerometer.walk / root_hz);
  ++count_;
  return reading;
}

}  // namespace zloam::simulator
