#pragma once
// The inertial sensor's part in one sweep of the odometry: what is foreseen, whether it is
// believed, what is learned of it (inertial_filter.hpp).

#include <optional>

#include "odometry/inertial_filter.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

/// The state of the odometry after a sweep, as the next one's motion hangs on it.
struct MotionBefore {
  Vector6 twist_per_s = Vector6::Zero();
  double period_s = 0.1;
  /// of pose and twist
  Matrix12 covariance = Matrix12::Zero();
};

class InertialAid {
 public:
  explicit InertialAid(const Pose& T_base_imu) : T_base_imu_(T_base_imu) {}

  /// Adds up a sweep's readings; where they do not cover it, or there are none, there is nothing
  /// of it.
  void feel(ImuSpan readings, std::int64_t stamp_ns, std::uint32_t period_ns);

  /// Narrows what is known of the motion of a sweep that adjoins the one before, and has the bend
  /// as measured. begin_variance: what the begin may differ by from the end before. On probation it
  /// foresees for itself and changes nothing.
  void foresee(const MotionBefore& before, const Vector6& begin_variance,
               const OdometryConfig& config, MotionPrior& prior, MotionState& initial);
  /// Whether what was foreseen cannot be, after what the points say. covariance: of (T_odom_mid,
  /// twist per sweep), as solved.
  bool contradicts(const MotionState& solved, const Matrix12& covariance) const;
  /// Whether the points fit so much worse than they use to that what was foreseen may have led
  /// astray. fit: Solution::fit.
  bool misleads(double fit) const;
  /// The points have the word: as if nothing had been foreseen.
  void give_way();
  /// Whether the platform has stood still since the first sweep: what turns and pushes it then is
  /// bias and gravity. covariance: of (T_odom_mid, twist per sweep), as solved.
  bool rests(const MotionState& solved, const Matrix12& covariance, const OdometryConfig& config);

  /// How well the points fit in the end.
  void note_fit(double fit) { fit_ = fit; }

  /// State after the sweep, to be kept with its result. covariance: of the unknowns as solved
  /// (T_odom_mid, twist per sweep), of the prior where nothing was solved; covariance_end: of
  /// (T_odom_end, twist per second), as kept.
  std::optional<InertialState> learned(const MotionState& state, const Matrix12& covariance,
                                       const std::optional<Matrix12>& covariance_end,
                                       const OdometryConfig& config) const;
  void take(const std::optional<InertialState>& state) { state_ = state; }

  /// What mapping may use of it, when it was foreseen and believed.
  std::optional<InertialStep> step() const;
  bool felt() const { return felt_.has_value(); }
  /// Whether the motion was foretold, and that was believed.
  bool foreseen() const { return foreseen_.has_value() && !on_probation(); }
  bool on_probation() const { return state_ && state_->on_probation > 0; }

 private:
  InertialState past_the_sweep(const OdometryConfig& config) const;
  InertialState corrected_by(const MotionState& state, const Matrix12& covariance,
                             const Matrix12& covariance_end) const;

  Pose T_base_imu_;
  std::optional<InertialState> state_;
  std::optional<SweepInertia> felt_;
  std::optional<InertialPrediction> foreseen_;
  Pose T_odom_begin_ = Pose::Identity();
  bool wrong_ = false;
  double fit_ = 0.0;
  bool rests_ = false;
};

}  // namespace zloam::odometry
