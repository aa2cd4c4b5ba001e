#pragma once
// What can be set about mapping. Defaults stand here and nowhere else.

#include <array>
#include <cstdint>
#include <string>

#include "common/plane_map/config.hpp"

namespace zloam::mapping {

/// Matching against counted voxel planes. The range noise comes with the sweeps.
struct VoxelPlanesConfig {
  plane_map::PlaneMapConfig map;
  plane_map::MatcherConfig matcher;
  /// every so many points of a sweep are put into the tiles, which hold the points to look at
  std::uint32_t tile_stride = 4;
  /// of a dense sweep's surfaces fewer, but no fewer than these
  std::uint32_t enough_tile_points = 7000;
};

struct MappingConfig {
  /// every n-th sweep by number is mapped
  std::uint32_t every = 1;
  /// edge of a cube, m
  double tile_edge_m = 50.0;
  /// cubes kept in memory around the sensor, and cubes of the local map that map/surround shows
  /// (odd numbers)
  std::array<int, 3> window_tiles = {21, 21, 11};
  std::array<int, 3> local_tiles = {5, 5, 3};
  /// one map point a voxel, m
  double leaf_edge_m = 0.2;
  double leaf_plane_m = 0.4;
  /// what the prediction's covariance has at least, one sigma a mapped sweep
  double prior_sigma_m = 0.03;
  double prior_sigma_rad = 0.005;
  /// the odometry's covariance counts this many times (variance)
  double prior_scale = 1.0;
  /// published covariance of the pose, from comparison with ground truth (EXPERIMENTS.md): the
  /// solver takes the map as exact and its residuals as nearly independent. Its sigmas times these;
  double covariance_scale_m = 1.1;
  double covariance_scale_rad = 0.94;
  /// what the surest direction of the position lends to others by errors of the map's normals is
  /// taken off their information;
  double covariance_normal_error_rad = 0.2;
  /// what the map itself is off, in each direction, comes on top: one error for all sweeps that
  /// hang on it, which no number of points averages out; 0: the solver knows it;
  double covariance_map_m = 0.0;
  /// and, of the rotation, this share of the change of the turn from the sweep before: the motion
  /// within a sweep is taken as constant
  double covariance_turn_share = 0.018;
  /// a rotation known worse than this was drawn into the map, too, by the poses before: its
  /// variance v is published as v (1 + v / this^2); 0: the map's turn is taken as exact
  double covariance_map_turn_rad = 0.0025;
  /// a direction is degenerate when the points leave it open by more than this share of 10 m, or of
  /// a radian
  double drift_limit = 0.01;
  /// not inserted when the residual is above so many times its recent median
  double insert_residual_factor = 2.0;
  /// sweeps over which the median is taken
  int insert_residual_window = 21;
  /// a map of fewer points is founded with sweeps that matched nothing
  std::uint32_t founding_points = 300;
  /// inserted only when moved or turned by more since the last insertion; 0: every sweep
  double insert_distance_m = 0.0;
  double insert_rotation_rad = 0.0;
  /// a new odom frame is searched for this far around the last pose; accepted when so many of the
  /// features looked up match
  double bridge_distance_m = 2.0;
  double bridge_rotation_rad = 0.1745;
  double bridge_inlier_ratio = 0.5;
  /// so many sweeps without an accepted match: lost
  std::uint32_t bridge_sweeps = 20;
  /// evicted tiles are kept in memory up to this many points, then in a file in spill_directory
  std::uint64_t archive_points = 20'000'000;
  /// empty: in memory without a bound
  std::string spill_directory;
  VoxelPlanesConfig voxel_planes;
};

}  // namespace zloam::mapping
