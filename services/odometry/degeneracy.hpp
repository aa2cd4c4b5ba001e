#pragma once
// Finds the degenerate directions. The information about translation and about rotation is
// separated by Schur complements (no mixture of metres and radians; after Zhang, Kaess and Singh,
// ICRA 2016). A direction is degenerate when its sigma from the points alone exceeds the user's
// limit, after subtracting the information that errors of the normals can explain.

#include <Eigen/Core>

#include "common/geometry/se3.hpp"
#include "odometry/config.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

struct Degeneracy {
  bool degenerate = false;
  /// degenerate directions in base_link, unit; zero when none is degenerate
  Eigen::Vector3d weak_translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d weak_rotation = Eigen::Vector3d::Zero();
  /// one sigma along the least constrained direction, from the data and from the prediction; in m,
  /// or in rad when only a rotation is degenerate
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;
  /// information along the least constrained translation over that of all residuals: the mean
  /// squared share of the normals, 0..1
  double share = 0.0;
};

/// data: the residuals' H at the solution.
Degeneracy find_weak_directions(const NormalEquations& data, const MotionPrior& prior,
                                const OdometryConfig& config);

/// The unit vector of the least constrained translation of a pose (translation, rotation) with this
/// information, its rotation left free.
Eigen::Vector3d weakest_translation(const Matrix6& pose_information);

/// Removes the points' information along the least constrained translation as far as errors of the
/// normals can explain it: walls along a tunnel say nothing about the way through it, but the
/// errors of their normals add up. All of it is removed up to a mean squared share of the normals
/// of normal_error_rad squared, less of it above that. Only between walls, where the next weakest
/// direction is well constrained: on open ground, slopes are the only information.
void discount_spurious(double normal_error_rad, NormalEquations& data);

}  // namespace zloam::odometry
