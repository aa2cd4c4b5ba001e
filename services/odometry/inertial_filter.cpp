#include "odometry/inertial_filter.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <type_traits>

namespace zloam::odometry {
namespace {

constexpr int kGravity = 0, kForceBias = 3, kRateBias = 6, kDelay = 9;
constexpr double kMostDelay_s = 1e-9 * static_cast<double>(kImuMargin_ns);

double squared(double x) { return x * x; }

Eigen::Matrix3d diagonal(double sigma) { return squared(sigma) * Eigen::Matrix3d::Identity(); }

// Covariance of the drift of gravity, biases and delay.
InertialMatrix walk(const OdometryConfig& c, double over_s) {
  InertialMatrix q = InertialMatrix::Zero();
  q.block<3, 3>(kGravity, kGravity) = over_s * diagonal(c.imu_gravity_walk);
  q.block<3, 3>(kForceBias, kForceBias) = over_s * diagonal(c.imu_force_walk);
  q.block<3, 3>(kRateBias, kRateBias) = over_s * diagonal(c.imu_rate_walk);
  q(kDelay, kDelay) = over_s * squared(1e-3 * c.imu_delay_walk_ms);
  return q;
}

// Covariance of the step: integrated white noise, error of the mean force and scale error.
Matrix6 step_noise(const OdometryConfig& c, const SweepInertia& sweep, double between_s) {
  Matrix6 q = Matrix6::Zero();
  q.topLeftCorner<3, 3>() = between_s * diagonal(c.imu_force_noise) +
                            squared(between_s) * diagonal(c.imu_force_error_mps2);
  q.bottomRightCorner<3, 3>() = sweep.period_s * diagonal(c.imu_rate_noise) +
                                diagonal(c.imu_scale_error * sweep.turn_rad.norm());
  return q;
}

using StepByParameters = Eigen::Matrix<double, 6, kInertialParameters>;

// Derivative of the step by the delay: with a larger delay, later readings belong to the step. The
// mean force changes from that of the earlier sweep to that of the later one, in a frame that
// rotates as well; the rotation's rate changes from that at the begin to that at the end.
Vector6 step_by_delay(const InertialState& state, const SweepInertia& sweep) {
  const Eigen::Vector3d rate_begin = (sweep.turn_rad - 0.5 * sweep.bend_rad) / sweep.period_s;
  const Eigen::Vector3d felt_mps = state.mean_to_end_mps + sweep.begin_to_mean_mps;
  Vector6 by_delay;
  by_delay << sweep.mean_force_mps2 - state.mean_force_from_end_mps2 - rate_begin.cross(felt_mps),
      sweep.bend_rad / sweep.period_s;
  return by_delay;
}

// Keeps what the prediction of the next sweep starts from.
void adjoin(InertialState& state, const SweepInertia& sweep) {
  state.mean_to_end_mps = sweep.mean_to_end_mps;
  state.mean_force_from_end_mps2 = sweep.mean_force_from_end_mps2;
  state.adjoins = true;
}

// Visits all members in one order, for packing and unpacking.
template <class State, class Number>
void visit(State& s, Number&& number) {
  for (Eigen::Index i = 0; i < s.mean.size(); ++i) number(s.mean(i));
  for (Eigen::Index i = 0; i < s.covariance.size(); ++i) number(s.covariance(i));
  for (Eigen::Index i = 0; i < s.cross.size(); ++i) number(s.cross(i));
  for (int i = 0; i < 3; ++i) number(s.mean_to_end_mps(i));
  for (int i = 0; i < 3; ++i) number(s.mean_force_from_end_mps2(i));
  for (int i = 0; i < 3; ++i) number(s.rest_force_mps2(i));
  number(s.adjoins);
  number(s.resting);
  number(s.usual_fit);
  number(s.contradictions);
  number(s.on_probation);
  number(s.right);
}

}  // namespace

ImuErrors InertialState::errors() const {
  return {mean.segment<3>(kForceBias), mean.segment<3>(kRateBias),
          std::clamp(mean(kDelay), -kMostDelay_s, kMostDelay_s)};
}

double InertialState::delay_sigma_s() const { return std::sqrt(covariance(kDelay, kDelay)); }

std::vector<double> packed(const InertialState& state) {
  std::vector<double> numbers;
  visit(state, [&](const auto& value) { numbers.push_back(static_cast<double>(value)); });
  return numbers;
}

std::optional<InertialState> unpacked(std::span<const double> numbers) {
  static const std::size_t kSize = packed({}).size();
  if (numbers.size() != kSize) return std::nullopt;
  InertialState state;
  std::size_t i = 0;
  visit(state, [&](auto& value) {
    value = static_cast<std::remove_reference_t<decltype(value)>>(numbers[i++]);
  });
  return state;
}

InertialState begin_inertia(const SweepInertia& sweep, const Pose& T_odom_end, bool at_rest,
                            const OdometryConfig& c) {
  InertialState state;
  const Eigen::Matrix3d R = T_odom_end.linear();
  // The mean force is given in the frame at the sweep's begin.
  const Eigen::Matrix3d R_begin = R * exp_so3(-sweep.turn_rad);
  state.mean.segment<3>(kGravity) = -R_begin * sweep.mean_force_mps2;
  state.covariance.block<3, 3>(kGravity, kGravity) =
      diagonal(c.imu_force_bias_mps2) +
      diagonal(at_rest ? c.imu_rest_acceleration_mps2 : c.imu_start_acceleration_mps2);
  state.covariance.block<3, 3>(kForceBias, kForceBias) = diagonal(c.imu_force_bias_mps2);
  state.covariance.block<3, 3>(kGravity, kForceBias) = R_begin * diagonal(c.imu_force_bias_mps2);
  state.covariance.block<3, 3>(kForceBias, kGravity) =
      state.covariance.block<3, 3>(kGravity, kForceBias).transpose();
  state.covariance.block<3, 3>(kRateBias, kRateBias) = diagonal(c.imu_rate_bias_radps);
  state.covariance(kDelay, kDelay) = squared(1e-3 * c.imu_delay_sigma_ms);
  adjoin(state, sweep);
  state.resting = at_rest;
  state.rest_force_mps2 = sweep.mean_force_mps2;
  return state;
}

InertialPrediction foresee(const InertialState& state, const SweepInertia& sweep,
                           const Pose& T_odom_begin, const Vector6& twist_before_per_s,
                           double period_before_s, const Matrix12& covariance_before,
                           const OdometryConfig& c) {
  const double between_s = 0.5 * (period_before_s + sweep.period_s);
  const Eigen::Matrix3d to_base = T_odom_begin.linear().transpose();
  const Eigen::Vector3d gravity = to_base * state.mean.segment<3>(kGravity);
  InertialPrediction out;
  out.step.velocity_change_mps =
      state.mean_to_end_mps + sweep.begin_to_mean_mps + between_s * gravity;
  out.step.turn_rad = sweep.turn_rad;
  const Vector6 before = period_before_s * twist_before_per_s;
  out.twist_per_s = twist_after(out.step, before, period_before_s, sweep.period_s) / sweep.period_s;

  // Jacobians of (velocity change, rotation) by (pose, twist before) and by the parameters.
  Eigen::Matrix<double, 6, 12> by_motion = Eigen::Matrix<double, 6, 12>::Zero();
  by_motion.block<3, 3>(0, 3) = between_s * hat(gravity);
  StepByParameters by_parameters = StepByParameters::Zero();
  by_parameters.block<3, 3>(0, kGravity) = between_s * to_base;
  by_parameters.block<3, 3>(0, kForceBias) = -between_s * Eigen::Matrix3d::Identity();
  by_parameters.block<3, 3>(3, kRateBias) = -sweep.period_s * Eigen::Matrix3d::Identity();
  by_parameters.col(kDelay) = step_by_delay(state, sweep);

  // Jacobian of the twist by the step: V^-1 of its rotation, to first order, and the rotation
  // itself.
  Matrix6 by_step = Matrix6::Zero();
  by_step.topLeftCorner<3, 3>() = Eigen::Matrix3d::Identity() - 0.5 * hat(sweep.turn_rad);
  by_step.bottomRightCorner<3, 3>() = Eigen::Matrix3d::Identity() / sweep.period_s;
  Matrix12 F = Matrix12::Identity();
  F.bottomRows<6>() = by_step * by_motion;
  F.bottomRightCorner<6, 6>() +=
      twist_after_jacobian(out.step, before, period_before_s, sweep.period_s) * period_before_s /
      sweep.period_s;
  Eigen::Matrix<double, 12, kInertialParameters> G =
      Eigen::Matrix<double, 12, kInertialParameters>::Zero();
  G.bottomRows<6>() = by_step * by_parameters;

  const Matrix6 noise = step_noise(c, sweep, between_s);
  out.parameters = state.covariance + walk(c, between_s);
  out.cross = state.cross * F.transpose() + out.parameters * G.transpose();
  const Eigen::Matrix<double, 12, 12> mixed = F * state.cross.transpose() * G.transpose();
  out.covariance = F * covariance_before * F.transpose() + mixed + mixed.transpose() +
                   G * out.parameters * G.transpose();
  out.covariance.bottomRightCorner<6, 6>() += by_step * noise * by_step.transpose();
  out.covariance = 0.5 * (out.covariance + out.covariance.transpose()).eval();
  out.step.covariance = by_parameters * out.parameters * by_parameters.transpose() + noise;
  return out;
}

double contradiction(const InertialPrediction& foreseen, const Vector6& twist_per_s,
                     const Matrix6& covariance) {
  const Vector6 off = twist_per_s - foreseen.twist_per_s;
  const Matrix6 sum = foreseen.covariance.bottomRightCorner<6, 6>() + covariance;
  return off.dot(sum.ldlt().solve(off));
}

InertialState corrected(const InertialState& state, const InertialPrediction& foreseen,
                        const Pose& T_odom_begin, const SolvedMotion& solved,
                        const SweepInertia& sweep, const Matrix12& end_of_begin,
                        const Matrix12& bounded) {
  Vector12 off;
  off << log_se3(T_odom_begin.inverse() * solved.T_odom_begin),
      solved.twist_per_s - foreseen.twist_per_s;
  const InertialCross regression =
      foreseen.covariance.ldlt().solve(foreseen.cross.transpose()).transpose();
  InertialState out = state;
  out.mean += regression * off;
  out.covariance = foreseen.parameters +
                   regression * (solved.covariance - foreseen.covariance) * regression.transpose();
  out.covariance = 0.5 * (out.covariance + out.covariance.transpose()).eval();
  const InertialCross of_end = regression * end_of_begin.inverse();
  const Matrix12 full = end_of_begin * solved.covariance * end_of_begin.transpose();
  out.cross = of_end * bounded;
  // The errors that the bound removes from the pose remain with the twist.
  out.cross.rightCols<6>() += of_end * (full - bounded).rightCols<6>();
  adjoin(out, sweep);
  return out;
}

InertialState carried_past(const InertialState& state, const std::optional<SweepInertia>& sweep,
                           double over_s, const OdometryConfig& config) {
  InertialState out = state;
  out.covariance += walk(config, over_s);
  out.cross.setZero();
  out.adjoins = false;
  if (sweep) adjoin(out, *sweep);
  return out;
}

}  // namespace zloam::odometry
