#pragma once
// Functions that integration.cpp (the pose) and fused_quality.cpp (its quality) share.

#include <algorithm>
#include <cstdint>

#include "common/geometry/unobserved_motion.hpp"
#include "integration/integration.hpp"

namespace zloam::integration {

inline Matrix6 finite_or_zero(const Matrix6& covariance) {
  if (!covariance.allFinite()) return Matrix6::Zero();
  return 0.5 * (covariance + covariance.transpose());
}

/// The pose was measured, at least along some directions.
inline bool is_located(Health health) {
  return health == Health::kOk || health == Health::kDegenerate;
}

inline double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

/// Time over which the motion before an interruption is continued.
inline double bridged_s(const OdometryPose& before, const OdometryPose& after) {
  return std::clamp(seconds(after.instant_ns - before.instant_ns), 0.0, kLongestGap_s);
}

}  // namespace zloam::integration
