#pragma once
// Estimates gravity, the IMU's biases and the delay of its stamps beside the odometry, and predicts
// the next sweep's motion from the IMU before that sweep is matched.
//
// One Gaussian over the sweep's end, its twist and ten parameters (gravity in odom, bias of the
// accelerometer, bias of the gyroscope, delay of the stamps). The solver keeps mean and covariance
// of pose and twist; this filter keeps those of the parameters and their cross covariance with pose
// and twist. The next sweep's prior is the propagated Gaussian; the solver's result for pose and
// twist corrects the parameters through the cross covariance (a Kalman filter whose measurement is
// made elsewhere: the linear regression of the parameters on pose and twist stays, Rauch, Tung and
// Striebel 1965). So no information given to the solver counts twice.
//
// Loosely after LOAM (Zhang and Singh, RSS 2014, section V: orientation and the non-uniform part of
// the motion from an IMU), but with the whole motion as a prior of known covariance, and with
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

/// The parameters, their covariance, and their cross covariance with pose and twist.
inline constexpr int kInertialParameters = 10;
using InertialVector = Eigen::Matrix<double, kInertialParameters, 1>;
using InertialMatrix = Eigen::Matrix<double, kInertialParameters, kInertialParameters>;
using InertialCross = Eigen::Matrix<double, kInertialParameters, 12>;

/// State after a sweep. Parameters in the order gravity (odom, m/s^2), bias of the specific force
/// (m/s^2), bias of the rate (rad/s), both in base_link's axes, delay of the stamps (s).
struct InertialState {
  InertialVector mean = InertialVector::Zero();
  InertialMatrix covariance = InertialMatrix::Zero();
  /// with (T_odom_base tangent at base_link, twist per second)
  InertialCross cross = InertialCross::Zero();
  /// SweepInertia::mean_to_end_mps and mean_force_from_end_mps2 of the sweep; adjoins: they are
  /// known, and the next sweep's motion can be predicted
  Eigen::Vector3d mean_to_end_mps = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean_force_from_end_mps2 = Eigen::Vector3d::Zero();
  bool adjoins = false;
  /// at rest since the first sweep, with this mean force
  bool resting = false;
  Eigen::Vector3d rest_force_mps2 = Eigen::Vector3d::Zero();
  /// slow mean of Solution::fit over the sweeps it predicted
  double usual_fit = 0.0;
  /// number of wrong predictions, reduced by one for each so many correct ones
  std::uint32_t contradictions = 0;
  /// sweeps it has yet to predict correctly before it is trusted again
  std::uint32_t on_probation = 0;
  /// consecutive sweeps predicted correctly
  std::uint32_t right = 0;

  /// The delay is limited to what the readings beside a sweep allow for.
  ImuErrors errors() const;
  double delay_sigma_s() const;
};

/// All fields as numbers, to be kept with a sweep's result; nothing if the numbers are no state.
std::vector<double> packed(const InertialState& state);
std::optional<InertialState> unpacked(std::span<const double> numbers);

/// A sweep's predicted motion.
struct InertialPrediction {
  InertialStep step;
  Vector6 twist_per_s = Vector6::Zero();
  /// of (T_odom_begin tangent at the begin, twist per second), and of the parameters with it
  Matrix12 covariance = Matrix12::Identity();
  InertialCross cross = InertialCross::Zero();
  InertialMatrix parameters = InertialMatrix::Identity();
};

/// The solver's result for a sweep, as input of the filter.
struct SolvedMotion {
  Pose T_odom_begin = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  /// of both
  Matrix12 covariance = Matrix12::Identity();
};

/// From the first sweep whose motion is known: gravity is the measured force, with a smaller sigma
/// if the sensor was at rest.
InertialState begin_inertia(const SweepInertia& sweep, const Pose& T_odom_end, bool at_rest,
                            const OdometryConfig& config);

/// Predicts the motion of a sweep that directly follows that of the state, from T_odom_begin on.
/// Twist, period, covariance: of the sweep before, the covariance of its end and its twist.
InertialPrediction foresee(const InertialState& state, const SweepInertia& sweep,
                           const Pose& T_odom_begin, const Vector6& twist_before_per_s,
                           double period_before_s, const Matrix12& covariance_before,
                           const OdometryConfig& config);

/// Distance of a twist per second from the predicted one: squared, in sigmas of their difference.
/// covariance: of the twist (0 if the prediction was used to find it).
double contradiction(const InertialPrediction& foreseen, const Vector6& twist_per_s,
                     const Matrix6& covariance);

/// The state after the sweep. end_of_begin: Jacobian of end and twist by begin and twist; bounded:
/// covariance of end and twist as kept for the pose, at most what follows from the solver's.
InertialState corrected(const InertialState& state, const InertialPrediction& foreseen,
                        const Pose& T_odom_begin, const SolvedMotion& solved,
                        const SweepInertia& sweep, const Matrix12& end_of_begin,
                        const Matrix12& bounded);

/// The state after a sweep whose motion the IMU did not predict: the parameters as before, with
/// their drift added to the covariance.
InertialState carried_past(const InertialState& state, const std::optional<SweepInertia>& sweep,
                           double over_s, const OdometryConfig& config);

}  // namespace zloam::odometry
