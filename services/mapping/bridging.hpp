#pragma once
// Takes up the map again after the odometry's frame was broken off.

#include "common/geometry/fit_record.hpp"
#include "mapping/method.hpp"

namespace zloam::mapping {

/// How far off the guess may be.
Matrix6 bridge_covariance(const MappingConfig& config);

/// Whether it explains far less of the sweep than the sweeps before were explained.
bool explains_too_little(const Match& match, const FitRecord& fits);

/// Matches from several starts around the guess (the guess itself first; it ends when that is
/// accepted) and returns the one with most inliers. ok only when the share of inliers reaches
/// bridge_inlier_ratio, the residual is below twice the median of before (0: unknown) and as much
/// is explained as usually. The starts lie further out with each few of the sweeps that were
/// searched for before (attempt), up to four times as far.
Match bridge(MappingMethod& method, const MappingInput& input, const Prediction& guess,
             const MappingConfig& config, double median_residual_m, const FitRecord& fits,
             std::uint32_t attempt);

}  // namespace zloam::mapping
