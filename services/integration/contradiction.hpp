#pragma once
// When two measurements of one motion contradict each other.

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace zloam::integration {

/// A larger difference over one step is a discontinuity, not an error or a motion to learn from.
inline constexpr double kBreak_m = 2.0;

/// The difference, if a covariance that explains it is improbable; else zero. Limit of the squared
/// Mahalanobis distance: 99 % are below if the covariance is right (chi-squared with three degrees
/// of freedom).
inline Eigen::Vector3d contradiction(const Eigen::Vector3d& difference,
                                     const Eigen::Matrix3d& covariance) {
  constexpr double kLimit = 11.34;
  const double squared = difference.dot(covariance.ldlt().solve(difference));
  return squared > kLimit ? difference : Eigen::Vector3d::Zero();
}

}  // namespace zloam::integration
