#pragma once
// Points seen along a few metres of travel, in one frame that no later correction deforms.

#include <cstdint>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam {

struct Submap {
  std::uint64_t first_sweep = 0, last_sweep = 0;
  /// the sweep whose base_link is the submap's frame, in the middle of the way, and its instant, ns
  /// since the Unix epoch
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  /// pose of that frame in the map, as mapping estimated it
  Pose T_map_submap = Pose::Identity();
  /// covariance of the motion from the previous submap's frame to this one, its tangent at this
  /// one: from both poses, and from the directions that the points in between left unconstrained
  Matrix6 step_covariance = Matrix6::Zero();
  /// the sweep of the previous submap's frame; for the first submap its own
  std::uint64_t before_sweep = 0;
  /// distance travelled since that frame, m
  double step_m = 0.0;
  /// every sweep since that frame was matched with the map
  bool connected = true;
  double range_noise_m = 0.0;
  /// frame of the submap: means of voxels, in the order in which these were first hit
  std::vector<MapPoint> points;
  /// for each point: the groups of consecutive sweeps that hit its voxel, one bit per group, lowest
  /// first
  std::vector<std::uint64_t> hits;
  /// position of the sensor in the middle of each group, at most 64 of them
  std::vector<Eigen::Vector3d> origins;
};

}  // namespace zloam
