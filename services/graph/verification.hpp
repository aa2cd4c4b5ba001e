#pragma once
// Whether one submap lies at a place in another: its points are matched to the other's planes
// (point to plane, robust, as mapping matches a sweep), and points that do not lie on them count.
//
// The residual is no evidence where a street repeats itself; evidence is the overlap of the two: of
// walls and the like, as ground is everywhere, and of planes only, as some points are everywhere
// too.
//
// Frames: a place has its origin at the submap and the axes of the map by mapping, z up.

#include "common/geometry/se3.hpp"
#include "graph/config.hpp"
#include "graph/surfels.hpp"

namespace zloam::graph {

struct Overlap {
  Pose T_a_b = Pose::Identity();
  /// of T_a_b, tangent at b
  Matrix6 covariance = Matrix6::Zero();
  /// share of the planes of b off the ground that coincide with one of a, and vice versa; the
  /// smaller one
  double share = 0.0;
  /// rms of the residuals, m
  double residual_m = 0.0;
  /// mean squared share of the horizontal normals along the least constrained direction, [0, 0.5]
  double weakest_share = 0.0;
};

/// Matches from a first guess of T_a_b.
Overlap matched(const Surfaces& a, const Surfaces& b, const Pose& guess,
                const VerifyConfig& config);

}  // namespace zloam::graph
