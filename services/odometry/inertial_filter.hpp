#pragma once
// Gravity, the biases of an inertial sensor and the delay of its stamps, estimated beside the
// odometry, and what the sensor then says of the next sweep's motion before it is looked at.
//
// One Gaussian over the sweep's end, its twist and ten parameters (gravity in odom, bias of the
// accelerometer, bias of the gyroscope, delay of the stamps). Of pose and twist the solver keeps
// mean and covariance; here are those of the parameters and what they have in common with pose and
// twist. The next sweep's prior is the Gaussian carried on; what the solver then makes of pose and
// twist corrects the parameters by what they have in common (a Kalman filter whose measurement is
// made elsewhere: the linear regression of the parameters on pose and twist stays, Rauch, Tung and
// Striebel 1965). So nothing that the solver was told counts twice.
//
// Loosely after LOAM (Zhang and Singh, RSS 2014, section V: orientation and the non-uniform part of
// the motion from an IMU), with the whole motion as a prior of known covariance in its place, and
// biases. The delay as one more parameter: Li and Mourikis, Online Temporal Calibration for
// Camera-IMU Systems, IJRR 2014.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "common/geometry/inertial_step.hpp"
#include "odometry/config.hpp"
#include "odometry/imu_integration.hpp"

namespace zloam::odometry {

/// Of the parameters, and of them with pose and twist.
inline constexpr int kInertialParameters = 10;
using InertialVector = Eigen::Matrix<double, kInertialParameters, 1>;
using InertialMatrix = Eigen::Matrix<double, kInertialParameters, kInertialParameters>;
using InertialCross = Eigen::Matrix<double, kInertialParameters, 12>;

/// After a sweep. Parameters in the order gravity (odom, m/s^2), bias of the specific force
/// (m/s^2), bias of the rate (rad/s), both in base_link's axes, delay of the stamps (s).
struct InertialState {
  InertialVector mean = InertialVector::Zero();
  InertialMatrix covariance = InertialMatrix::Zero();
  /// with (T_odom_base tangent at base_link, twist per second)
  InertialCross cross = InertialCross::Zero();
  /// SweepInertia::mean_to_end_mps and mean_force_from_end_mps2 of the sweep; the next one's motion
  /// can only be told after it
  Eigen::Vector3d mean_to_end_mps = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean_force_from_end_mps2 = Eigen::Vector3d::Zero();
  bool adjoins = false;
  /// at rest since the first sweep, with this mean force
  bool resting = false;
  Eigen::Vector3d rest_force_mps2 = Eigen::Vector3d::Zero();
  /// slow mean of Solution::fit of the sweeps that it foretold
  double usual_fit = 0.0;
  /// how often it said what was not so, less by one for each so many sweeps of which it was right
  std::uint32_t contradictions = 0;
  /// sweeps that it has yet to be right of before it is believed again
  std::uint32_t on_probation = 0;
  /// sweeps in a row that it foretold
  std::uint32_t right = 0;

  /// The delay within what the readings beside a sweep allow for.
  ImuErrors errors() const;
  double delay_sigma_s() const;
};

/// All of it as numbers, to be kept with a sweep's result; none from numbers of another kind.
std::vector<double> packed(const InertialState& state);
std::optional<InertialState> unpacked(std::span<const double> numbers);

/// A sweep's motion as foreseen.
struct InertialPrediction {
  InertialStep step;
  Vector6 twist_per_s = Vector6::Zero();
  /// of (T_odom_begin tangent at the begin, twist per second), and the parameters' with it
  Matrix12 covariance = Matrix12::Identity();
  InertialCross cross = InertialCross::Zero();
  InertialMatrix parameters = InertialMatrix::Identity();
};

/// What the solver made of a sweep, as the filter takes it.
struct SolvedMotion {
  Pose T_odom_begin = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  /// of both
  Matrix12 covariance = Matrix12::Identity();
};

/// From the first sweep whose motion is known: gravity is what the sensor felt, and the surer if it
/// was at rest.
InertialState begin_inertia(const SweepInertia& sweep, const Pose& T_odom_end, bool at_rest,
                            const OdometryConfig& config);

/// The motion of a sweep that adjoins the one of the state. pose: where it begins; twist, period,
/// covariance: of the sweep before, the covariance of its end and its twist.
InertialPrediction foresee(const InertialState& state, const SweepInertia& sweep,
                           const Pose& T_odom_begin, const Vector6& twist_before_per_s,
                           double period_before_s, const Matrix12& covariance_before,
                           const OdometryConfig& config);

/// How far a twist per second, of the given covariance (0 when the foreseen one was used to find
/// it), is from the foreseen one: squared, in sigmas of their difference.
double contradiction(const InertialPrediction& foreseen, const Vector6& twist_per_s,
                     const Matrix6& covariance);

/// The state after the sweep. end_of_begin: what end and twist change by with begin and twist;
/// bounded: covariance of these as kept for the pose, no larger than it follows from the solver's.
InertialState corrected(const InertialState& state, const InertialPrediction& foreseen,
                        const Pose& T_odom_begin, const SolvedMotion& solved,
                        const SweepInertia& sweep, const Matrix12& end_of_begin,
                        const Matrix12& bounded);

/// The state after a sweep whose motion the sensor did not foretell: parameters as before, but for
/// what they wander by.
InertialState carried_past(const InertialState& state, const std::optional<SweepInertia>& sweep,
                           double over_s, const OdometryConfig& config);

}  // namespace zloam::odometry
