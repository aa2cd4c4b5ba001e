#pragma once
// Predicts the motion since the last mapped pose from two sources: the odometry's step, and the
// motion between the last two mapped poses, continued. Each is weighted by its recent error in each
// direction: a matrix of mean squares over about the last ten mapped poses. The odometry leads
// unless it is degenerate; then (tunnel, open yard: it errs by decimetres a sweep and does not
// always report it) the map leads.

#include <Eigen/Core>
#include <optional>

#include "common/geometry/error_record.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::integration {

/// Degenerate directions, unit vectors in base_link; zero when none is degenerate.
struct Weak {
  bool degenerate = false;
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotation = Eigen::Vector3d::Zero();
  /// one sigma along the least constrained direction, m (rad when only a rotation is degenerate)
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;

  template <class Bits>
  void each(Bits& bits) {
    bits(degenerate, translation, rotation, sigma_measured, sigma_predicted);
  }
};

class StepFusion {
 public:
  /// A mapped pose followed the one before by mapped_step (mapped_covariance: of both poses), while
  /// the odometry measured odometry_step over this many sweeps.
  void observe(const Pose& mapped_step, const Matrix6& mapped_covariance, const Pose& odometry_step,
               double over_s, int sweeps);
  /// What the errors of the odometry's steps so far do not explain of such a step: its difference
  /// from the odometry's, a translation tangent at the mapped pose; zero if they explain it.
  Eigen::Vector3d contradiction_m(const Pose& mapped_step, const Matrix6& mapped_covariance,
                                  const Pose& odometry_step, int sweeps) const;
  /// The next mapped pose is not consecutive to the last one.
  void forget_motion() { twist_per_s_.reset(); }

  /// One sweep's step: over_s long, ending age_s after the last mapped pose.
  Pose step(const Pose& odometry_step, const Weak& weak, double over_s, double age_s) const;

  /// Covariance of such a step by its recent errors, beyond those of the mapped poses; none before
  /// the first error. Once the map's motion is too old to be continued, by the odometry's errors.
  std::optional<Matrix6> covariance(double age_s) const;

  template <class Bits>
  void each(Bits& bits) {
    bits(odometry_, map_, fused_, twist_per_s_);
  }

 private:
  // Errors over one sweep.
  ErrorRecord odometry_{0.003, 0.001};
  ErrorRecord map_{0.05, 0.015};
  ErrorRecord fused_{0.003, 0.001};
  std::optional<Vector6> twist_per_s_;
};

}  // namespace zloam::integration
