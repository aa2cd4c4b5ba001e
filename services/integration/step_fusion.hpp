#pragma once
// The motion since the last mapped pose, from two predictions of it: the odometry's step, and the
// motion between the last two mapped poses, carried on. Each counts by how far off it was lately,
// in each direction: a matrix of mean squares over the last ten mapped poses or so. The odometry
// leads where it sees; where it does not (a tunnel, an open yard: there it errs by decimetres a
// sweep, and not always knows), the map does.

#include <Eigen/Core>
#include <optional>

#include "common/geometry/error_record.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::integration {

/// Directions that the data leave open, unit vectors in base_link; zero when none is weak.
struct Weak {
  bool degenerate = false;
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d rotation = Eigen::Vector3d::Zero();
  /// one sigma along the weakest direction, m (rad when only a rotation is weak)
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;

  template <class Bits>
  void each(Bits& bits) {
    bits(degenerate, translation, rotation, sigma_measured, sigma_predicted);
  }
};

class StepFusion {
 public:
  /// A mapped pose followed the one before by mapped_step, known to the covariance of both, where
  /// the odometry had odometry_step, over so many sweeps.
  void observe(const Pose& mapped_step, const Matrix6& mapped_covariance, const Pose& odometry_step,
               double over_s, int sweeps);
  /// The next mapped pose does not follow the last one.
  void forget_motion() { twist_per_s_.reset(); }

  /// One sweep's step: over_s long, ending age_s after the last mapped pose.
  Pose step(const Pose& odometry_step, const Weak& weak, double over_s, double age_s) const;

  /// Of such a step, as they did lately beyond the errors of the mapped poses; none before the first
  /// of these.
  std::optional<Matrix6> covariance() const;

  template <class Bits>
  void each(Bits& bits) {
    bits(odometry_, map_, fused_, twist_per_s_);
  }

 private:
  // Of the errors in one sweep.
  ErrorRecord odometry_{0.003, 0.001};
  ErrorRecord map_{0.05, 0.015};
  ErrorRecord fused_{0.003, 0.001};
  std::optional<Vector6> twist_per_s_;
};

}  // namespace zloam::integration
