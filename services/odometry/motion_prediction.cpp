#include "odometry/motion_prediction.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::odometry {
namespace {

// Longer gaps between sweeps are bridged as if they were this long: the prediction is void anyway.
constexpr double kMaxGap_s = 2.0;
// A sweep adjoins the one before if gap or overlap is at most this share of its period.
constexpr double kAdjoining = 0.1;

double gap_before_s(const MotionMemory& before, const SweepTime& sweep) {
  const double period_s = sweep.period_ns * 1e-9;
  const double gap_s = (sweep.stamp_ns - before.prev_instant_ns) * 1e-9;
  return before.started ? std::clamp(gap_s, -period_s, kMaxGap_s) : 0.0;
}

// Time since the motion was last measured.
double blind_time_s(const MotionMemory& before, const SweepTime& sweep) {
  return std::max(0.0, gap_before_s(before, sweep)) +
         before.predicted_in_row * sweep.period_ns * 1e-9;
}

// Root mean square of the accelerations of the last sweeps in each axis.
Vector6 recent_acceleration(const MotionMemory& before) {
  Vector6 squares = Vector6::Zero();
  int n = 0;
  for (const auto& a : before.accelerations) {
    if (!a) continue;
    squares += a->sure.array().square().matrix();
    ++n;
  }
  return (squares / std::max(1, n)).array().sqrt();
}

// Root sum of squares of the configured acceleration and of this platform's recent one.
Vector6 acceleration_sigma(const MotionMemory& before, const OdometryConfig& config) {
  const Vector6 any =
      sigmas(config.acceleration_sigma_mps2, config.angular_acceleration_sigma_radps2);
  return (any.array().square() + recent_acceleration(before).array().square()).sqrt();
}

// Sigma of the change of the twist within a sweep, from recent accelerations; zero if negligible.
Vector6 bend_sigma(const MotionMemory& before, double period_s) {
  constexpr double kNothing = 1e-4;  // m or rad: moves a point by an eighth of it at most
  constexpr double kLeast = 1e-6;    // for a negligible axis beside one that counts
  const Vector6 sigma = period_s * period_s * recent_acceleration(before);
  if (!(sigma.maxCoeff() > kNothing)) return Vector6::Zero();
  return sigma.cwiseMax(kLeast);
}

// Sigmas of the difference between a sweep's begin and the end of the sweep before.
Vector6 continuity_sigmas(const MotionMemory& before, const OdometryConfig& config,
                          double period_s) {
  return sigmas(config.continuity_sigma_m, config.continuity_sigma_rad) +
         config.continuity_share * period_s *
             sigmas(before.twist_change_per_s.head<3>().norm(),
                    before.twist_change_per_s.tail<3>().norm());
}

// Propagates the joint covariance of end and twist of the sweep before. Their errors are
// correlated: where a direction was mostly observed in the first half of a sweep, an error of the
// twist displaces the end. Tied to such an end as if it were certain, the next twist would err the
// other way and by more: a zigzag that grows until the window breaks.
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
  // Both changes come from the same acceleration, so they are fully correlated.
  const Vector6 together = strayed.cwiseProduct(prior.twist_sigma);
  covariance.topRightCorner<6, 6>().diagonal() += together;
  covariance.bottomLeftCorner<6, 6>().diagonal() += together;
  prior.information = information_of(covariance).value_or(prior.information);
}

// The matching converges from a rotation error of this size: half a metre at five metres.
constexpr double kFoundTurn_rad = 0.1;
constexpr double kSearchedSigmas = 2.0;
constexpr int kMostStarts = 15;

// Adds starts with other angular rates about one axis than the predicted one.
void add_turned_starts(const MotionMemory& before, const SweepTime& sweep, Eigen::Index axis,
                       double alpha_radps2, const MotionState& predicted,
                       std::vector<MotionState>& starts) {
  const double period_s = sweep.period_ns * 1e-9;
  const double gap_s = gap_before_s(before, sweep);
  const double over_s = period_s + blind_time_s(before, sweep);
  // Rotation at the sweep's middle per change of the rate, which builds up during the gap.
  const double turn_per_rate_s = 0.5 * std::max(0.0, gap_s) + 0.5 * period_s;
  const double reach_rad = kSearchedSigmas * alpha_radps2 * over_s * turn_per_rate_s;
  const int reach = std::min(kMostStarts, static_cast<int>(reach_rad / kFoundTurn_rad));
  for (int i = -reach; i <= reach; ++i) {
    if (i == 0) continue;
    Vector6 twist_per_s = before.twist_per_s;
    const double change = i * kFoundTurn_rad / turn_per_rate_s;
    twist_per_s[3 + axis] += change;
    Vector6 gap_twist = before.twist_per_s;
    gap_twist[3 + axis] += 0.5 * change;
    MotionState start = predicted;
    start.twist = period_s * twist_per_s;
    start.T_odom_mid = before.T_odom_base * exp_se3(gap_s * gap_twist) * exp_se3(0.5 * start.twist);
    starts.push_back(start);
  }
}

}  // namespace

Vector6 sigmas(double translation, double rotation) {
  Vector6 s;
  s << translation, translation, translation, rotation, rotation, rotation;
  return s;
}

Vector6 moving_twist_sigma(const MotionMemory& before, const OdometryConfig& config,
                           double period_s, double over_s) {
  return period_s * over_s * acceleration_sigma(before, config);
}

std::vector<MotionState> turned_starts(const MotionMemory& before, const SweepTime& sweep,
                                       const OdometryConfig& config, const MotionState& predicted) {
  std::vector<MotionState> starts;
  if (!before.twist_known) return starts;
  const double alpha_radps2 = acceleration_sigma(before, config).tail<3>().maxCoeff();
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    add_turned_starts(before, sweep, axis, alpha_radps2, predicted, starts);
  }
  return starts;
}

Prediction predict(const MotionMemory& before, const SweepTime& sweep,
                   const OdometryConfig& config) {
  const double period_s = sweep.period_ns * 1e-9;
  const double gap_s = gap_before_s(before, sweep);
  const double blind_s = blind_time_s(before, sweep);
  const Vector6 strayed = 0.5 * blind_s * blind_s * acceleration_sigma(before, config);
  Prediction p;
  p.prior.T_odom_begin = before.T_odom_base * exp_se3(before.twist_per_s * gap_s);
  p.prior.twist = before.twist_per_s * period_s;
  p.prior.begin_sigma = sigmas(config.begin_sigma_m, config.begin_sigma_rad) + strayed;
  p.prior.twist_sigma = before.twist_known
                            ? moving_twist_sigma(before, config, period_s, period_s + blind_s)
                            : sigmas(config.initial_speed_sigma_mps * period_s,
                                     config.initial_rate_sigma_radps * period_s);
  p.prior.information = independent(p.prior.begin_sigma, p.prior.twist_sigma);
  const bool state_known = before.twist_known && before.state_covariance;
  if (state_known) carry_on(before, config, gap_s, period_s, strayed, p.prior);
  p.state.twist = p.prior.twist;
  p.prior.bend_sigma = bend_sigma(before, period_s);
  p.state.T_odom_mid = p.prior.T_odom_begin * exp_se3(0.5 * p.prior.twist);
  if (before.twist_known) {
    Eigen::Index axis = 0;
    const double alpha = acceleration_sigma(before, config).tail<3>().maxCoeff(&axis);
    add_turned_starts(before, sweep, axis, alpha, p.state, p.starts);
  }
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
