#pragma once
// Calibration of the published covariance. The solver takes the map as exact, its normals too, and
// its residuals as nearly independent; what that leaves out was found by comparison with the
// simulator's truth (docs/experiments/2026-11-22-published-covariance.md). And what is known of a
// sweep's pose before it is matched.

#include "common/geometry/se3.hpp"
#include "mapping/config.hpp"

namespace zloam::mapping {

/// Covariance of T_map_base to publish, right tangent (m, rad), from the solver's. turn_change_rad:
/// by how much the sweep turned more or less than the one before.
Matrix6 published_covariance(const Matrix6& solved, double turn_change_rad,
                             const MappingConfig& config);

/// Nothing where it is none: not finite, or of negative variances.
Matrix6 sane_covariance(const Matrix6& covariance);

/// Of the pose that the odometry's step leads to, by the step's covariance.
Matrix6 prior_covariance(const MappingConfig& config, const Matrix6& step_covariance);

}  // namespace zloam::mapping
