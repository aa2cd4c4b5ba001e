#pragma once
// Which direction the data leave open. The information about translation and about rotation is
// taken apart by Schur complements (no mixture of metres and radians; after Zhang, Kaess and Singh,
// ICRA 2016). A direction is weak when the points alone leave it open by more than the limit that
// the user sets, after what errors of their normals may pretend to is taken off.

#include <Eigen/Core>

#include "common/geometry/se3.hpp"
#include "odometry/config.hpp"
#include "odometry/motion_solver.hpp"

namespace zloam::odometry {

struct Degeneracy {
  bool degenerate = false;
  /// weak directions in base_link, unit; zero when none is weak
  Eigen::Vector3d weak_translation = Eigen::Vector3d::Zero();
  Eigen::Vector3d weak_rotation = Eigen::Vector3d::Zero();
  /// one sigma along the weakest direction by the data and by the prediction; in m, or in rad when
  /// only a rotation is weak
  double sigma_measured = 0.0;
  double sigma_predicted = 0.0;
  /// information along the weakest translation over that of all residuals: the mean squared share
  /// of the normals, 0..1
  double share = 0.0;
};

/// data: the residuals' H at the solution.
Degeneracy find_weak_directions(const NormalEquations& data, const MotionPrior& prior,
                                const OdometryConfig& config);

/// The unit vector along which a pose (translation, rotation) of this information is held least,
/// its rotation left free.
Eigen::Vector3d weakest_translation(const Matrix6& pose_information);

/// Takes off what the points say along the translation that they hold least, as far as it may be
/// nothing but the errors of normals: walls along a tunnel say nothing of the way through it, but
/// what their normals are off by adds up. All of it up to a mean squared share of the normals of
/// normal_error_rad squared, the less of it the larger that is. Only between walls, that is where
/// the next weakest direction is held well: on open ground its slopes are all there is.
void discount_spurious(double normal_error_rad, NormalEquations& data);

}  // namespace zloam::odometry
