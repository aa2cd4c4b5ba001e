#pragma once
// A-LOAM knows no covariance, and messages want one: a fixed guess.

#include "common/geometry/se3.hpp"

namespace zloam::aloam {

struct Sigmas {
  double translation_m, rotation_rad;
};
/// Of a step of the odometry, and of a mapped pose, where the surroundings constrain the pose in
/// every direction: A-LOAM does not detect others. Integration calls a pose degenerate if its sigma
/// exceeds 0.1 m (integration.drift_limit). A guess above that would call every pose degenerate,
/// along an arbitrary axis; this one stays below it also some steps after the mapped pose.
inline constexpr Sigmas kStep{0.02, 0.005}, kMapped{0.03, 0.005};

inline Matrix6 nominal_covariance(const Sigmas& sigmas) {
  Matrix6 covariance = Matrix6::Zero();
  covariance.diagonal().head<3>().setConstant(sigmas.translation_m * sigmas.translation_m);
  covariance.diagonal().tail<3>().setConstant(sigmas.rotation_rad * sigmas.rotation_rad);
  return covariance;
}

}  // namespace zloam::aloam
