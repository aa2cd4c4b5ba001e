#pragma once
// What can be set about integration. Defaults stand here and nowhere else.

#include <cstdint>
#include <string>

namespace zloam::integration {

struct IntegrationConfig {
  /// replay: every n-th sweep by number is mapped (must equal mapping's own)
  std::uint32_t mapping_every = 1;
  /// replay: pose n uses the correction of the last mapped sweep at or below n minus this
  std::uint32_t correction_delay = 1;
  /// a change of the correction that moves the pose by more is marked as a jump
  double jump_m = 0.1;
  double jump_rad = 0.035;
  /// what the odometry says of a step, one sigma, counts by this much in the fused pose's
  /// covariance (from comparison with ground truth, mapping/EXPERIMENTS.md)
  double step_scale_m = 0.1;
  double step_scale_rad = 0.22;
  /// the pose is degenerate when the points leave a direction open by more than this share of 10 m,
  /// or when its own position is known worse than that
  double drift_limit = 0.01;
  /// files of a run, in this folder: trajectory.tum, trajectory.kitti, odometry.tum; empty: none
  std::string output_dir = "out";
};

}  // namespace zloam::integration
