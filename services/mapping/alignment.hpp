#pragma once
// Least squares for one pose from points on lines and planes and a predicted pose.
//
// Minimises  sum_i info_i * rho(e_i^2) + x^T P^-1 x,  e_i the distance of T * p_i from its line or
// plane, rho the Geman-McClure loss k^2 s / (k^2 + s), and x the difference to the prediction:
// x = [R_p^T (t - t_p); Log(R_p^T R)]. Gauss-Newton on the right tangent of T with weights from
// rho'. The 6x6 normal equations are summed in one pass, in the order of the residuals.

#include <vector>

#include "common/geometry/se3.hpp"
#include "mapping/config.hpp"
#include "mapping/method.hpp"
#include "mapping/surfaces.hpp"

namespace zloam::mapping {

struct Residual {
  Eigen::Vector3d point_base = Eigen::Vector3d::Zero();
  Surface surface;
  bool line = false;
  /// 1 / m^2
  double information = 1.0;
};

struct NormalEquations {
  Matrix6 H = Matrix6::Zero();
  Vector6 g = Vector6::Zero();
  double cost = 0.0;
  /// weighted sum of squared distances (m^2) and sum of the weights, for the rms
  double squared_m2 = 0.0;
  double weight = 0.0;
  std::uint32_t inliers = 0;
};

/// Data part at the pose.
NormalEquations accumulate(const std::vector<Residual>& residuals, const Pose& T_map_base,
                           double kernel_m);

/// What the noise of the planes' normals adds to H on average: information that is not there.
Matrix6 noise_information(const std::vector<Residual>& residuals, const Pose& T_map_base,
                          double kernel_m);

/// Adds the prediction to the equations.
void add_prior(NormalEquations& equations, const Prediction& prediction, const Pose& T_map_base);

/// Moves the pose by a step of the right tangent.
Pose retract(const Pose& T_map_base, const Vector6& step);

/// Iterates on fixed residuals until the step is below the limits, at most max_iterations times.
Pose align(const std::vector<Residual>& residuals, const Prediction& prediction, double kernel_m,
           int max_iterations, double stop_translation_m, double stop_rotation_rad);

}  // namespace zloam::mapping
