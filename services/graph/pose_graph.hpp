#pragma once
// Fits poses to relative poses: SE(3) between-factors, least squares by Ceres. Of poses that
// factors connect the first one is fixed. Loops are weighted robustly, so that a wrong one does not
// distort the whole graph.

#include <cstddef>
#include <span>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::graph {

struct Between {
  std::size_t from = 0, to = 0;
  Pose T_from_to = Pose::Identity();
  /// tangent at `to`, m and rad
  Matrix6 covariance = Matrix6::Identity();
  bool robust = false;
};

/// Squared distance of a pose from the expected one, by their difference's covariance; six DOF.
double squared_distance(const Pose& expected, const Pose& found, const Matrix6& covariance);

/// Squared distance of a factor from the relative pose of two poses, six degrees of freedom.
double chi2(const Between& factor, const Pose& T_world_from, const Pose& T_world_to);

struct Optimised {
  std::vector<Pose> poses;
  /// sums over the factors, robust ones with their robust cost
  double chi2_before = 0.0, chi2_after = 0.0;
  /// the iteration converged; else the poses must not be used
  bool converged = false;
};

/// Optimises from these poses on. One thread, no clock: the same input gives the same bytes.
Optimised optimised(std::vector<Pose> poses, std::span<const Between> factors);

}  // namespace zloam::graph
