#include "odometry/motion_prediction.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::odometry {
namespace {

// Longer gaps between sweeps are bridged as if they were this long: the prediction is void anyway.
constexpr double kMaxGap_s = 2.0;
// A sweep that begins so much of its time after the last one's end at most goes on with its turn.
constexpr double kAdjoining = 0.1;

double gap_before_s(const MotionMemory& before, const SweepTime& sweep) {
  const double period_s = sweep.period_ns * 1e-9;
  const double gap_s = (sweep.stamp_ns - before.prev_instant_ns) * 1e-9;
  return before.started ? std::clamp(gap_s, -period_s, kMaxGap_s) : 0.0;
}

// What a begin may differ by from the end before it.
Vector6 continuity_sigmas(const MotionMemory& before, const OdometryConfig& config,
                          double period_s) {
  return sigmas(config.continuity_sigma_m, config.continuity_sigma_rad) +
         config.continuity_share * period_s *
             sigmas(before.twist_change_per_s.head<3>().norm(),
                    before.twist_change_per_s.tail<3>().norm());
}

// How much of the difference between two measured turns is the turn's own change: the rest is what
// their covariances say. Where a turn is hardly seen (a flat yard, leaves) a bend made of noise
// would deskew the next sweep wrongly, and that its turn.
Eigen::Matrix3d bend_share(const Matrix12& state_covariance, const OdometryConfig& config,
                           double period_s) {
  const double own = config.bend_sigma_rad * config.bend_sigma_rad;
  const Eigen::Matrix3d measured =
      2.0 * period_s * period_s * state_covariance.bottomRightCorner<3, 3>();
  if (!(own > 0.0) || !measured.allFinite()) return Eigen::Matrix3d::Zero();
  return own * (measured + own * Eigen::Matrix3d::Identity()).inverse();
}

// The end of the sweep before and its twist err together: where most of what a sweep saw of a
// direction was seen in its first half, the end is the twist's error away from it. Tied to such an
// end as if it were sure, the next sweep's twist errs the other way round and by more, and so on: a
// zig-zag that grows until the window is torn.
void carry_on(const MotionMemory& before, const OdometryConfig& config, double gap_s,
              double period_s, const Vector6& strayed, MotionPrior& prior) {
  Matrix12 F = Matrix12::Zero();
  F.topLeftCorner<6, 6>() = adjoint(exp_se3(-gap_s * before.twist_per_s));
  F.topRightCorner<6, 6>() = gap_s * Matrix6::Identity();
  F.bottomRightCorner<6, 6>() = period_s * Matrix6::Identity();
  Vector12 change;
  change << continuity_sigmas(before, config, period_s) + strayed, prior.twist_sigma;
  Matrix12 covariance = F * *before.state_covariance * F.transpose();
  covariance.diagonal() += change.array().square().matrix();
  prior.information = information_of(covariance).value_or(prior.information);
}

}  // namespace

Vector6 sigmas(double translation, double rotation) {
  Vector6 s;
  s << translation, translation, translation, rotation, rotation, rotation;
  return s;
}

Vector6 moving_twist_sigma(const OdometryConfig& config, double period_s, double over_s) {
  return period_s * over_s *
         sigmas(config.acceleration_sigma_mps2, config.angular_acceleration_sigma_radps2);
}

Prediction predict(const MotionMemory& before, const SweepTime& sweep,
                   const OdometryConfig& config) {
  const double period_s = sweep.period_ns * 1e-9;
  const double gap_s = gap_before_s(before, sweep);
  const double blind_s = std::max(0.0, gap_s) + before.predicted_in_row * period_s;
  const double a = config.acceleration_sigma_mps2;
  const double alpha = config.angular_acceleration_sigma_radps2;
  const Vector6 strayed = sigmas(0.5 * a * blind_s * blind_s, 0.5 * alpha * blind_s * blind_s);
  Prediction p;
  p.prior.T_odom_begin = before.T_odom_base * exp_se3(before.twist_per_s * gap_s);
  p.prior.twist = before.twist_per_s * period_s;
  p.prior.begin_sigma = sigmas(config.begin_sigma_m, config.begin_sigma_rad) + strayed;
  p.prior.twist_sigma = before.twist_known
                            ? moving_twist_sigma(config, period_s, period_s + blind_s)
                            : sigmas(config.initial_speed_sigma_mps * period_s,
                                     config.initial_rate_sigma_radps * period_s);
  p.prior.information = independent(p.prior.begin_sigma, p.prior.twist_sigma);
  const bool state_known = before.twist_known && before.state_covariance;
  if (state_known) carry_on(before, config, gap_s, period_s, strayed, p.prior);
  p.state.twist = p.prior.twist;
  if (state_known && gap_s < kAdjoining * period_s) {
    p.state.turn_before = period_s * before.twist_per_s.tail<3>();
    p.state.bend_share = bend_share(*before.state_covariance, config, period_s);
  }
  p.state.T_odom_mid = p.prior.T_odom_begin * exp_se3(0.5 * p.prior.twist);
  return p;
}

Prediction foresee(const MotionMemory& before, const SweepTime& sweep, const OdometryConfig& config,
                   InertialAid& inertial) {
  Prediction p = predict(before, sweep, config);
  if (inertial.felt()) p.prior.normal_error_rad = config.imu_normal_error_rad;
  const double period_s = sweep.period_ns * 1e-9;
  const bool adjoins = std::abs(gap_before_s(before, sweep)) <= kAdjoining * period_s;
  if (!before.twist_known || !before.state_covariance || !adjoins) return p;
  inertial.foresee({before.twist_per_s, before.prev_period_s, *before.state_covariance},
                   continuity_sigmas(before, config, period_s).array().square(), config, p.prior,
                   p.state);
  return p;
}

}  // namespace zloam::odometry
