#include "odometry/inertial_aid.hpp"

#include <Eigen/Cholesky>
#include <algorithm>

#include "common/geometry/motion_covariance.hpp"

namespace zloam::odometry {
namespace {

// Six degrees of freedom: exceeded by chance once in a million sweeps.
constexpr double kContradictionChiSquared = 38.0;
// Tolerated errors of the points' twist: in foliage its covariance is overconfident.
constexpr double kTolerated_mps = 0.15;
constexpr double kTolerated_radps = 0.025;
// Ratio of the fit to its slow mean above which the prediction may be wrong, and the mean's decay
// per sweep.
constexpr double kMisleading = 1.5;
constexpr double kFitMemory = 0.9;
// A wrong prediction puts the IMU on probation for this many sweeps, each time twice as long: an
// IMU with a wrong mounting or delay predicts correctly as long as nothing moves.
constexpr std::uint32_t kProbation = 10;
constexpr std::uint32_t kMostDoublings = 8;
// One contradiction, such as a bump in the road, is forgiven after this many correct sweeps.
constexpr std::uint32_t kForgiven = 300;
// 95 % of the twists of a sensor at rest are below: chi-squared with six degrees of freedom.
constexpr double kRestChiSquared = 12.59;
// Root mean square of the force readings about their mean at rest; a running motor causes more.
constexpr double kRestSpread_mps2 = 0.1;
// Change of the mean force since the first sweep: any platform that sets off exceeds it.
constexpr double kRestChange_mps2 = 0.03;

}  // namespace

void InertialAid::feel(ImuSpan readings, std::int64_t stamp_ns, std::uint32_t period_ns) {
  period_s_ = 1e-9 * period_ns;
  felt_.reset();
  foreseen_.reset();
  wrong_ = false;
  rests_ = false;
  fit_.reset();
  if (readings.empty()) return;
  felt_ = integrate(readings, stamp_ns, period_ns, T_base_imu_,
                    state_ ? state_->errors() : ImuErrors{});
}

void InertialAid::foresee(const MotionBefore& before, const Vector6& begin_variance,
                          const OdometryConfig& config, MotionPrior& prior, MotionState& initial) {
  if (!felt_ || !state_ || !state_->adjoins) return;
  T_odom_begin_ = prior.T_odom_begin;
  foreseen_ = odometry::foresee(*state_, *felt_, T_odom_begin_, before.twist_per_s, before.period_s,
                                before.covariance, config);
  foreseen_->covariance.diagonal().head<6>() += begin_variance;
  const auto information =
      information_of(with_twist_scaled(foreseen_->covariance, felt_->period_s));
  if (!information) foreseen_.reset();
  if (!foreseen()) return;
  prior.information = *information;
  prior.twist = felt_->period_s * foreseen_->twist_per_s;
  initial.twist = prior.twist;
  prior.bend << Eigen::Vector3d::Zero(), felt_->bend_rad;
  prior.bend_sigma.setZero();
  initial.bend = prior.bend;
  initial.T_odom_mid = prior.T_odom_begin * exp_se3(0.5 * prior.twist);
}

bool InertialAid::contradicts(const MotionState& solved, const Matrix12& covariance) const {
  if (!foreseen_) return false;
  const double per_s = 1.0 / felt_->period_s;
  Matrix6 of_twist = Matrix6::Zero();
  if (on_probation()) of_twist = per_s * per_s * covariance.bottomRightCorner<6, 6>();
  of_twist.diagonal().head<3>().array() += kTolerated_mps * kTolerated_mps;
  of_twist.diagonal().tail<3>().array() += kTolerated_radps * kTolerated_radps;
  return contradiction(*foreseen_, per_s * solved.twist, of_twist) > kContradictionChiSquared;
}

bool InertialAid::misleads(double fit) const {
  return foreseen() && state_->usual_fit > 0.0 && fit > kMisleading * state_->usual_fit;
}

void InertialAid::give_way() {
  foreseen_.reset();
  wrong_ = true;
}

// At rest: the readings are steady, the measured rotation is within the gyroscope's bias, and the
// points show no motion.
bool InertialAid::rests(const MotionState& solved, const Matrix12& covariance,
                        const OdometryConfig& config) {
  if (!felt_ || wrong_ || (state_ && !state_->resting)) return false;
  const Eigen::Vector3d before = state_ ? state_->rest_force_mps2 : felt_->mean_force_mps2;
  const Matrix6 of_twist = covariance.bottomRightCorner<6, 6>();
  rests_ = felt_->turn_rad.norm() < 3.0 * config.imu_rate_bias_radps * felt_->period_s &&
           felt_->force_spread_mps2 < kRestSpread_mps2 &&
           (felt_->mean_force_mps2 - before).norm() < kRestChange_mps2 &&
           solved.twist.dot(of_twist.ldlt().solve(solved.twist)) < kRestChiSquared;
  return rests_;
}

InertialState InertialAid::past_the_sweep(const OdometryConfig& config) const {
  InertialState past = carried_past(*state_, felt_, period_s_, config);
  past.resting = rests_;
  if (wrong_) {
    past.right = 0;
    past.on_probation = kProbation << past.contradictions;
    past.contradictions = std::min(past.contradictions + 1, kMostDoublings);
  } else if (foreseen_ && past.on_probation > 0) {
    --past.on_probation;
  }
  return past;
}

InertialState InertialAid::corrected_by(const MotionState& state, const Matrix12& covariance,
                                        const Matrix12& covariance_end) const {
  const double per_s = 1.0 / felt_->period_s;
  SolvedMotion solved;
  solved.T_odom_begin = state.T_odom_begin();
  solved.twist_per_s = per_s * state.twist;
  const Matrix12 to_begin = motion_jacobian(state, -0.5);
  solved.covariance = with_twist_scaled(to_begin * covariance * to_begin.transpose(), per_s);
  Vector12 units = Vector12::Ones();
  units.tail<6>().setConstant(per_s);
  const Matrix12 end_of_begin = units.asDiagonal() * motion_jacobian(state, 0.5) *
                                to_begin.inverse() * units.cwiseInverse().asDiagonal();
  return corrected(*state_, *foreseen_, T_odom_begin_, solved, *felt_, end_of_begin,
                   covariance_end);
}

std::optional<InertialState> InertialAid::learned(const MotionState& state,
                                                  const Matrix12& covariance,
                                                  const std::optional<Matrix12>& covariance_end,
                                                  const OdometryConfig& config) const {
  if (!state_) {
    if (!felt_ || !covariance_end) return std::nullopt;
    return begin_inertia(*felt_, state.T_odom_end(), rests_, config);
  }
  if (!foreseen() || !covariance_end) return past_the_sweep(config);
  InertialState next = corrected_by(state, covariance, *covariance_end);
  next.resting = rests_;
  if (!fit_) return next;
  next.usual_fit =
      state_->usual_fit > 0.0 ? kFitMemory * state_->usual_fit + (1.0 - kFitMemory) * *fit_ : *fit_;
  if (++next.right % kForgiven == 0 && next.contradictions > 0) --next.contradictions;
  return next;
}

std::optional<InertialStep> InertialAid::step() const {
  if (!foreseen()) return std::nullopt;
  InertialStep step = foreseen_->step;
  step.at_rest = rests_;
  return step;
}

}  // namespace zloam::odometry
