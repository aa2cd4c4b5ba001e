#pragma once
// Calibration of the published covariance. The solver takes the map and its normals as exact, and
// its residuals as nearly independent; the rest was found by comparison with the simulator's truth
// (docs/experiments/2026-11-22-published-covariance.md). Also the covariance of a sweep's pose
// before it is matched.

#include "common/geometry/se3.hpp"
#include "mapping/config.hpp"

namespace zloam::mapping {

/// Covariance of T_map_base to publish, right tangent (m, rad), from the solver's. turn_change_rad:
/// change of the sweep's rotation since the sweep before.
Matrix6 published_covariance(const Matrix6& solved, double turn_change_rad,
                             const MappingConfig& config);

/// Zero if it is not a covariance: not finite, or with negative variances.
Matrix6 sane_covariance(const Matrix6& covariance);

/// Covariance of the pose predicted by the odometry's step.
Matrix6 prior_covariance(const MappingConfig& config, const Matrix6& step_covariance);

}  // namespace zloam::mapping
