#include "mapping/degeneracy.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace zloam::mapping {
namespace {

constexpr double kTiny = 1e-9;

struct Axes {
  Eigen::Matrix3d vectors = Eigen::Matrix3d::Identity();
  Eigen::Vector3d measured = Eigen::Vector3d::Zero();   // one sigma
  Eigen::Vector3d predicted = Eigen::Vector3d::Zero();  // one sigma
  Eigen::Vector3d lambda = Eigen::Vector3d::Zero();
};

// Information of the first block when the second is free.
Eigen::Matrix3d schur(const Eigen::Matrix3d& a, const Eigen::Matrix3d& b,
                      const Eigen::Matrix3d& c) {
  const Eigen::Matrix3d regular = c + kTiny * Eigen::Matrix3d::Identity();
  const Eigen::Matrix3d rest = a - b * regular.inverse() * b.transpose();
  return 0.5 * (rest + rest.transpose());
}

// Eigenvectors are those of the information as measured; the noise is taken off along them.
Axes axes(const Eigen::Matrix3d& information, const Eigen::Matrix3d& noise,
          const Eigen::Matrix3d& prior) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(information);
  Axes result;
  result.vectors = solver.eigenvectors();
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d v = result.vectors.col(i);
    result.lambda[i] = std::max(solver.eigenvalues()[i] - v.dot(noise * v), kTiny);
    result.measured[i] = 1.0 / std::sqrt(result.lambda[i]);
    result.predicted[i] = std::sqrt(std::max(v.dot(prior * v), kTiny * kTiny));
  }
  return result;
}

}  // namespace

WeakAxes judge(const Matrix6& data_information, const Matrix6& noise_information,
               const Matrix6& prior_covariance, const MappingConfig& config, bool was_degenerate) {
  const Eigen::Matrix3d tt = data_information.topLeftCorner<3, 3>();
  const Eigen::Matrix3d tr = data_information.topRightCorner<3, 3>();
  const Eigen::Matrix3d rr = data_information.bottomRightCorner<3, 3>();
  const Axes t = axes(schur(tt, tr, rr), noise_information.topLeftCorner<3, 3>(),
                      prior_covariance.topLeftCorner<3, 3>());
  const Axes r = axes(schur(rr, tr.transpose(), tt), noise_information.bottomRightCorner<3, 3>(),
                      prior_covariance.bottomRightCorner<3, 3>());
  const double limit = was_degenerate ? config.degenerate_off : config.degenerate_on;
  WeakAxes result;
  for (int i = 2; i >= 0; --i) {
    if (t.measured[i] > limit * t.predicted[i]) {
      const Eigen::Vector3d v = t.vectors.col(i);
      result.report.weak_translation = v;
      result.strong_projection.topLeftCorner<3, 3>() -= v * v.transpose();
    }
    if (r.measured[i] > limit * r.predicted[i]) {
      const Eigen::Vector3d v = r.vectors.col(i);
      result.report.weak_rotation = v;
      result.strong_projection.bottomRightCorner<3, 3>() -= v * v.transpose();
    }
  }
  const bool weak_t = !result.report.weak_translation.isZero();
  const bool weak_r = !result.report.weak_rotation.isZero();
  result.report.degenerate = weak_t || weak_r;
  result.report.sigma_measured = weak_r && !weak_t ? r.measured[0] : t.measured[0];
  result.report.sigma_predicted = weak_r && !weak_t ? r.predicted[0] : t.predicted[0];
  result.report.share = t.lambda[0] / std::max(tt.trace(), kTiny);
  return result;
}

}  // namespace zloam::mapping
