#pragma once
// Whether one submap lies at a place in another: its points are matched to the other's planes
// (point to plane, robust, as mapping matches a sweep), and what does not lie on them counts.
//
// The residual tells nothing where a street repeats itself; what tells is how much of each of the
// two the other has: walls and the like, as the ground lies everywhere, and planes only, as some
// thing or other is everywhere, too.
//
// Frames: a place has its origin at the submap and the axes of the map as mapping had them, z up.

#include "common/geometry/se3.hpp"
#include "graph/config.hpp"
#include "graph/surfels.hpp"

namespace zloam::graph {

struct Overlap {
  Pose T_a_b = Pose::Identity();
  /// of T_a_b, tangent at b
  Matrix6 covariance = Matrix6::Zero();
  /// share of the planes of b off the ground that lie in one of a, and the other way round; the
  /// smaller one
  double share = 0.0;
  /// rms of the residuals, m
  double residual_m = 0.0;
  /// mean squared share of the horizontal normals along the direction that has least, [0, 0.5]
  double weakest_share = 0.0;
};

/// From a first guess of T_a_b.
Overlap matched(const Surfaces& a, const Surfaces& b, const Pose& guess,
                const VerifyConfig& config);

}  // namespace zloam::graph
