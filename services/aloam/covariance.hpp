#pragma once
// A-LOAM knows no covariance, and messages want one: a fixed guess.

#include "common/geometry/se3.hpp"

namespace zloam::aloam {

struct Sigmas {
  double translation_m, rotation_rad;
};
/// of a step of the odometry, and of a mapped pose
inline constexpr Sigmas kStep{0.05, 0.01}, kMapped{0.3, 0.02};

inline Matrix6 nominal_covariance(const Sigmas& sigmas) {
  Matrix6 covariance = Matrix6::Zero();
  covariance.diagonal().head<3>().setConstant(sigmas.translation_m * sigmas.translation_m);
  covariance.diagonal().tail<3>().setConstant(sigmas.rotation_rad * sigmas.rotation_rad);
  return covariance;
}

}  // namespace zloam::aloam
