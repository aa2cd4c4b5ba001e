#include "odometry/degeneracy.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/geometry/health.hpp"
#include "common/geometry/motion_covariance.hpp"

namespace zloam::odometry {
namespace {

struct Weakest {
  Eigen::Vector3d direction;
  double sigma;
  double information;
  double next_information;
};

// Between walls the second least constrained direction has at least this mean squared share of the
// normals.
constexpr double kWallsLeastShare = 0.05;

// Information about one 3-vector when the other is unknown as well.
Eigen::Matrix3d schur(const Eigen::Matrix3d& own, const Eigen::Matrix3d& cross,
                      const Eigen::Matrix3d& other) {
  const Eigen::Matrix3d regular = other + 1e-9 * Eigen::Matrix3d::Identity();
  return own - cross * regular.ldlt().solve(cross.transpose());
}

Weakest weakest(const Eigen::Matrix3d& information) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(
      0.5 * (information + information.transpose()));
  const double value = std::max(1e-12, solver.eigenvalues()[0]);
  Eigen::Vector3d direction = solver.eigenvectors().col(0);
  // The sign is arbitrary: the largest component is made positive.
  Eigen::Index largest = 0;
  direction.cwiseAbs().maxCoeff(&largest);
  if (direction[largest] < 0.0) {
    direction = -direction;
  }
  return {direction, 1.0 / std::sqrt(value), value, solver.eigenvalues()[1]};
}

Weakest weakest_translation_of(const Matrix6& pose_information) {
  return weakest(schur(pose_information.topLeftCorner<3, 3>(),
                       pose_information.topRightCorner<3, 3>(),
                       pose_information.bottomRightCorner<3, 3>()));
}

}  // namespace

Eigen::Vector3d weakest_translation(const Matrix6& pose_information) {
  return weakest_translation_of(pose_information).direction;
}

void discount_spurious(double normal_error_rad, NormalEquations& data) {
  const Weakest least = weakest_translation_of(data.H.topLeftCorner<6, 6>());
  const double all = std::max(1e-12, data.H.topLeftCorner<3, 3>().trace());
  if (least.next_information < kWallsLeastShare * all) return;
  const double share = least.information / all;
  const double error = normal_error_rad * normal_error_rad;
  const double real = 1.0 - error / std::max(error, share);
  keep_along(least.direction, real, data.H, data.g);
}

Degeneracy find_weak_directions(const NormalEquations& data, const MotionPrior& prior,
                                const OdometryConfig& config) {
  const Matrix6 own = data.H.topLeftCorner<6, 6>();
  const Matrix6 cross = data.H.topRightCorner<6, 6>();
  const Vector6 twist_information = prior.twist_sigma.array().square().inverse();
  Matrix6 twist = data.H.bottomRightCorner<6, 6>();
  twist.diagonal() += twist_information;
  const Matrix6 pose = own - cross * twist.ldlt().solve(cross.transpose());
  const Eigen::Matrix3d tt = pose.topLeftCorner<3, 3>();
  const Eigen::Matrix3d tr = pose.topRightCorner<3, 3>();
  const Eigen::Matrix3d rr = pose.bottomRightCorner<3, 3>();
  const Weakest translation = weakest(schur(tt, tr, rr));
  const Weakest rotation = weakest(schur(rr, tr.transpose(), tt));
  const double pretended = std::pow(config.plane_normal_error_rad, 2) * tt.trace();
  const double measured_m = 1.0 / std::sqrt(std::max(1e-12, translation.information - pretended));
  // Sigma of the sweep's middle, from those of its begin and of half its twist.
  const Vector6 predicted =
      (prior.begin_sigma.array().square() + 0.25 * prior.twist_sigma.array().square()).sqrt();
  const double predicted_m = predicted.head<3>().maxCoeff();
  const double predicted_rad = predicted.tail<3>().maxCoeff();
  const bool weak_translation = measured_m > config.drift_limit * kJudgedWay_m;
  const bool weak_rotation = rotation.sigma > config.drift_limit;

  Degeneracy out;
  out.degenerate = weak_translation || weak_rotation;
  if (weak_translation) {
    out.weak_translation = translation.direction;
  }
  if (weak_rotation) {
    out.weak_rotation = rotation.direction;
  }
  const bool in_rad = weak_rotation && !weak_translation;
  out.sigma_measured = in_rad ? rotation.sigma : measured_m;
  out.sigma_predicted = in_rad ? predicted_rad : predicted_m;
  out.share = translation.information / std::max(1e-12, tt.trace());
  return out;
}

}  // namespace zloam::odometry
