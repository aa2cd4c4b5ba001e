#pragma once
// Poses that fit all relative ones best: SE(3) between-factors, least squares by Ceres. Of poses
// that factors connect the first one is held. Loops count robustly, so that one that is wrong does
// not bend the whole.

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

/// Of a pose from the expected one, by the covariance of their difference; six degrees of freedom.
double squared_distance(const Pose& expected, const Pose& found, const Matrix6& covariance);

/// Squared distance of a factor from what two poses say, six degrees of freedom.
double chi2(const Between& factor, const Pose& T_world_from, const Pose& T_world_to);

struct Optimised {
  std::vector<Pose> poses;
  /// sums over the factors, with the robust ones as they count
  double chi2_before = 0.0, chi2_after = 0.0;
  /// it came to rest; else the poses are not to be used
  bool converged = false;
};

/// From these poses on. One thread, no clock: the same input gives the same bytes.
Optimised optimised(std::vector<Pose> poses, std::span<const Between> factors);

}  // namespace zloam::graph
