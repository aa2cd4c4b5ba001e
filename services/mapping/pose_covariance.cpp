#include "mapping/pose_covariance.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>

namespace zloam::mapping {
namespace {

// Lower limit of the smallest variance relative to the largest: no measurement has a direction
// constrained a thousand times better (sigma) than the least constrained one.
constexpr double kLeastShare = 1e-6;
// Upper limit of the map's contribution relative to the pose's own rotation variance: larger ones
// were never compared with truth.
constexpr double kMostOfTheMap = 10.0;

// Errors of the map's normals leak information of the best constrained direction into the others:
// a variance v grows by v^2 error^2 / least, where least is the smallest variance.
Eigen::Matrix3d borrowed(const Eigen::Matrix3d& position, double normal_error_rad) {
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(position, Eigen::EigenvaluesOnly);
  const double least = std::max(solver.eigenvalues()[0], kLeastShare * solver.eigenvalues()[2]);
  if (!(least > 0.0)) return Eigen::Matrix3d::Zero();
  return normal_error_rad * normal_error_rad / least * position * position;
}

// Where a sweep constrains its rotation poorly, so did the sweeps that built the map. The resulting
// rotation error of the map is common to all sweeps matched to it and does not average out.
Eigen::Matrix3d of_the_map(const Eigen::Matrix3d& rotation, double known_rad) {
  if (!(known_rad > 0.0)) return Eigen::Matrix3d::Zero();
  const double worse = rotation.trace() / 3.0 / (known_rad * known_rad);
  return std::min(worse, kMostOfTheMap) * rotation;
}

}  // namespace

Matrix6 published_covariance(const Matrix6& solved, double turn_change_rad,
                             const MappingConfig& config) {
  const Eigen::Matrix3d position = solved.topLeftCorner<3, 3>();
  Vector6 scale;
  scale.head<3>().setConstant(config.covariance_scale_m);
  scale.tail<3>().setConstant(config.covariance_scale_rad);
  Matrix6 covariance = scale.asDiagonal() * solved * scale.asDiagonal();
  covariance.topLeftCorner<3, 3>() += config.covariance_scale_m * config.covariance_scale_m *
                                      borrowed(position, config.covariance_normal_error_rad);
  covariance.diagonal().head<3>().array() += config.covariance_map_m * config.covariance_map_m;
  const double bend_rad = config.covariance_turn_share * turn_change_rad;
  covariance.diagonal().tail<3>().array() += bend_rad * bend_rad;
  covariance.bottomRightCorner<3, 3>() +=
      of_the_map(covariance.bottomRightCorner<3, 3>(), config.covariance_map_turn_rad);
  return 0.5 * (covariance + covariance.transpose());
}

Matrix6 sane_covariance(const Matrix6& covariance) {
  if (!covariance.allFinite()) return Matrix6::Zero();
  Matrix6 symmetric = 0.5 * (covariance + covariance.transpose());
  if (symmetric.diagonal().minCoeff() < 0.0) return Matrix6::Zero();
  return symmetric;
}

Matrix6 prior_covariance(const MappingConfig& config, const Matrix6& step_covariance) {
  Matrix6 covariance = config.prior_scale * sane_covariance(step_covariance);
  covariance.diagonal().head<3>().array() += config.prior_sigma_m * config.prior_sigma_m;
  covariance.diagonal().tail<3>().array() += config.prior_sigma_rad * config.prior_sigma_rad;
  return covariance;
}

}  // namespace zloam::mapping
