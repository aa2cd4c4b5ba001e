#pragma once
// Configuration of integration. Every default is written here and nowhere else; keys of the robot's
// file and their meaning: integration_stage.cpp.

#include <cstdint>
#include <string>

namespace zloam::integration {

struct IntegrationConfig {
  std::uint32_t mapping_every = 1;  ///< value of mapping.every
  std::uint32_t correction_delay = 1;
  double jump_m = 0.1;
  double jump_rad = 0.035;
  /// factors on the sigmas of the odometry's steps in the fused pose's covariance; constants,
  /// calibrated against ground truth (docs/experiments/2026-11-22-published-covariance.md)
  double step_scale_m = 0.1;
  double step_scale_rad = 0.22;
  double drift_limit = 0.01;
  std::string output_dir = "out";
};

}  // namespace zloam::integration
