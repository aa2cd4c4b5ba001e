#include "mapping/alignment.hpp"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>

namespace zloam::mapping {
namespace {

// d Log(R Exp(t)) / dt at t = 0 for Log(R) = theta (Barfoot 2017, eq. 7.76, right version).
Eigen::Matrix3d right_jacobian_inverse(const Eigen::Vector3d& theta) {
  const double angle = theta.norm();
  const Eigen::Matrix3d skew = hat(theta);
  double factor = 1.0 / 12.0;
  if (angle > 1e-4) {
    factor = 1.0 / (angle * angle) - (1.0 + std::cos(angle)) / (2.0 * angle * std::sin(angle));
  }
  return Eigen::Matrix3d::Identity() + 0.5 * skew + factor * skew * skew;
}

double kernel_weight(double squared_m2, double kernel_m) {
  const double k2 = kernel_m * kernel_m;
  const double root = k2 / (k2 + squared_m2);
  return root * root;
}

void note(NormalEquations& sum, const Residual& r, double squared_m2, double weight,
          double kernel_m) {
  const double k2 = kernel_m * kernel_m;
  sum.cost += r.information * k2 * squared_m2 / (k2 + squared_m2);
  sum.squared_m2 += weight * squared_m2;
  sum.weight += weight;
  if (squared_m2 < k2) ++sum.inliers;
}

void add_plane(NormalEquations& sum, const Residual& r, const Pose& T, double kernel_m) {
  const double distance = r.surface.axis.dot(T * r.point_base - r.surface.point);
  const double weight = kernel_weight(distance * distance, kernel_m);
  const Eigen::Vector3d normal_base = T.linear().transpose() * r.surface.axis;
  Vector6 J;
  J << normal_base, r.point_base.cross(normal_base);
  const double scale = weight * r.information;
  sum.H.noalias() += (scale * J) * J.transpose();
  sum.g += (scale * distance) * J;
  note(sum, r, distance * distance, weight, kernel_m);
}

void add_line(NormalEquations& sum, const Residual& r, const Pose& T, double kernel_m) {
  const Eigen::Vector3d axis_base = T.linear().transpose() * r.surface.axis;
  const Eigen::Vector3d offset = T.linear().transpose() * (T * r.point_base - r.surface.point);
  const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis_base * axis_base.transpose();
  const Eigen::Vector3d error = across * offset;
  const double weight = kernel_weight(error.squaredNorm(), kernel_m);
  Eigen::Matrix<double, 3, 6> J;
  J << across, -across * hat(r.point_base);
  const double scale = weight * r.information;
  sum.H.noalias() += (scale * J.transpose()) * J;
  sum.g += scale * (J.transpose() * error);
  note(sum, r, error.squaredNorm(), weight, kernel_m);
}

}  // namespace

NormalEquations accumulate(const std::vector<Residual>& residuals, const Pose& T_map_base,
                           double kernel_m) {
  NormalEquations sum;
  for (const Residual& r : residuals) {
    if (r.line) {
      add_line(sum, r, T_map_base, kernel_m);
    } else {
      add_plane(sum, r, T_map_base, kernel_m);
    }
  }
  return sum;
}

Matrix6 noise_information(const std::vector<Residual>& residuals, const Pose& T_map_base,
                          double kernel_m) {
  Matrix6 sum = Matrix6::Zero();
  const Eigen::Matrix3d R_base_map = T_map_base.linear().transpose();
  for (const Residual& r : residuals) {
    if (r.line) continue;
    const double distance = r.surface.axis.dot(T_map_base * r.point_base - r.surface.point);
    const double scale = kernel_weight(distance * distance, kernel_m) * r.information;
    Eigen::Matrix<double, 6, 3> J;
    J << Eigen::Matrix3d::Identity(), hat(r.point_base);
    sum.noalias() += scale * J *
                     (R_base_map * r.surface.normal_covariance * R_base_map.transpose()) *
                     J.transpose();
  }
  return sum;
}

void add_prior(NormalEquations& equations, const Prediction& prediction, const Pose& T_map_base) {
  const Pose& T_p = prediction.T_map_base;
  const Eigen::Matrix3d R_difference = T_p.linear().transpose() * T_map_base.linear();
  Vector6 x;
  x.head<3>() = T_p.linear().transpose() * (T_map_base.translation() - T_p.translation());
  x.tail<3>() = log_so3(R_difference);
  Matrix6 J = Matrix6::Zero();
  J.topLeftCorner<3, 3>() = R_difference;
  J.bottomRightCorner<3, 3>() = right_jacobian_inverse(x.tail<3>());
  const Matrix6 information = prediction.covariance.inverse();
  equations.H += J.transpose() * information * J;
  equations.g += J.transpose() * (information * x);
  equations.cost += x.dot(information * x);
}

Pose retract(const Pose& T_map_base, const Vector6& step) {
  Pose moved = T_map_base;
  moved.translation() += T_map_base.linear() * step.head<3>();
  moved.linear() = T_map_base.linear() * exp_so3(step.tail<3>());
  return normalised(moved);
}

Pose align(const std::vector<Residual>& residuals, const Prediction& prediction, double kernel_m,
           int max_iterations, double stop_translation_m, double stop_rotation_rad) {
  Pose T_map_base = prediction.T_map_base;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    NormalEquations equations = accumulate(residuals, T_map_base, kernel_m);
    add_prior(equations, prediction, T_map_base);
    const Vector6 step = -equations.H.ldlt().solve(equations.g);
    if (!step.allFinite()) break;
    T_map_base = retract(T_map_base, step);
    if (step.head<3>().norm() < stop_translation_m && step.tail<3>().norm() < stop_rotation_rad) {
      break;
    }
  }
  return T_map_base;
}

}  // namespace zloam::mapping
