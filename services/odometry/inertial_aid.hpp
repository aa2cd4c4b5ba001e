#pragma once
// The IMU's part in one sweep of the odometry: predicts the motion, decides whether the prediction
// is trusted, and learns the sensor's errors (inertial_filter.hpp).

#include <optional>

#include "odometry/inertial_filter.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

/// The state of the odometry after a sweep, from which the next sweep's motion is predicted.
struct MotionBefore {
  Vector6 twist_per_s = Vector6::Zero();
  double period_s = 0.1;
  /// of pose and twist
  Matrix12 covariance = Matrix12::Zero();
};

class InertialAid {
 public:
  explicit InertialAid(const Pose& T_base_imu) : T_base_imu_(T_base_imu) {}

  /// Preintegrates a sweep's readings. Without readings, or where they do not cover the sweep,
  /// there is no result.
  void feel(ImuSpan readings, std::int64_t stamp_ns, std::uint32_t period_ns);

  /// Tightens the prior of a sweep that directly follows the one before, and sets the measured
  /// change of the angular rate. begin_variance: of the step from the end before to the begin. On
  /// probation it predicts for itself only and changes neither prior nor initial.
  void foresee(const MotionBefore& before, const Vector6& begin_variance,
               const OdometryConfig& config, MotionPrior& prior, MotionState& initial);
  /// Whether the solution from the points excludes the prediction. covariance: of (T_odom_mid,
  /// twist per sweep), as solved.
  bool contradicts(const MotionState& solved, const Matrix12& covariance) const;
  /// Whether the points fit so much worse than usual that the prediction may be wrong. fit:
  /// Solution::fit.
  bool misleads(double fit) const;
  /// Drops the prediction as wrong: the points alone count.
  void give_way();
  /// Whether the platform has stood still since the first sweep: rotation and force measured then
  /// are bias and gravity. covariance: of (T_odom_mid, twist per sweep), as solved.
  bool rests(const MotionState& solved, const Matrix12& covariance, const OdometryConfig& config);

  /// Records how well the points fit in the end, if they were matched.
  void note_fit(double fit) { fit_ = fit; }

  /// State after the sweep, to be kept with its result. covariance: of the unknowns as solved
  /// (T_odom_mid, twist per sweep), or of the prior if nothing was solved; covariance_end: of
  /// (T_odom_end, twist per second), as kept.
  std::optional<InertialState> learned(const MotionState& state, const Matrix12& covariance,
                                       const std::optional<Matrix12>& covariance_end,
                                       const OdometryConfig& config) const;
  void take(const std::optional<InertialState>& state) { state_ = state; }

  /// The preintegrated motion for mapping, if it was predicted and trusted.
  std::optional<InertialStep> step() const;
  bool felt() const { return felt_.has_value(); }
  /// Whether the motion was predicted and the prediction is trusted.
  bool foreseen() const { return foreseen_.has_value() && !on_probation(); }
  bool on_probation() const { return state_ && state_->on_probation > 0; }

 private:
  InertialState past_the_sweep(const OdometryConfig& config) const;
  InertialState corrected_by(const MotionState& state, const Matrix12& covariance,
                             const Matrix12& covariance_end) const;

  Pose T_base_imu_;
  std::optional<InertialState> state_;
  /// of the sweep, also without readings
  double period_s_ = 0.0;
  std::optional<SweepInertia> felt_;
  std::optional<InertialPrediction> foreseen_;
  Pose T_odom_begin_ = Pose::Identity();
  bool wrong_ = false;
  /// of this sweep; nothing: it was not matched, and tells nothing of the prediction
  std::optional<double> fit_;
  bool rests_ = false;
};

}  // namespace zloam::odometry
