#pragma once
// Configuration of mapping. Every default is written here and nowhere else.
//
// Keys of the robot's file and their meaning: mapping_parameters.cpp. The fields that it does not
// bind, with a comment here, are constants of the method: chosen on the worlds of docs/experiments,
// where a better value for one world lost another. zloam-offline sets them for experiments.

#include <array>
#include <cstdint>
#include <string>

#include "common/plane_map/config.hpp"

namespace zloam::mapping {

/// The range noise comes with the sweeps.
struct VoxelPlanesConfig {
  plane_map::PlaneMapConfig map;
  plane_map::MatcherConfig matcher;
  std::uint32_t tile_stride = 4;
  /// minimum of a dense sweep's plane points that go into the tiles
  std::uint32_t enough_tile_points = 7000;
};

/// kLocalize: an existing map that does not change. kExtend: the map is fixed until the robot is
/// found in it; then it grows.
enum class MappingMode : std::uint8_t { kMap, kLocalize, kExtend };

struct MappingConfig {
  MappingMode mode = MappingMode::kMap;
  std::uint32_t every = 1;
  double tile_edge_m = 50.0;
  std::array<int, 3> window_tiles = {21, 21, 11};
  std::array<int, 3> local_tiles = {5, 5, 3};
  double leaf_edge_m = 0.2;
  double leaf_plane_m = 0.4;
  /// added to the odometry's covariance of a step, one sigma
  double prior_sigma_m = 0.03;
  double prior_sigma_rad = 0.005;
  /// factor on the odometry's covariance of a step
  double prior_scale = 1.0;
  /// Calibration of the published covariance against ground truth
  /// (docs/experiments/2026-11-22-published-covariance.md): the solver takes the map as exact and
  /// its residuals as nearly independent. Factors on its sigmas;
  double covariance_scale_m = 1.1;
  double covariance_scale_rad = 0.94;
  /// assumed normal-vector error; limits how much information the best-constrained direction leaks
  /// into the others;
  double covariance_normal_error_rad = 0.2;
  /// error of the map itself in each direction, common to all sweeps matched to it; 0: none;
  double covariance_map_m = 0.0;
  /// share of the change of the rotation since the last sweep, added to the rotation's sigma: the
  /// change of the twist within a sweep is known that badly;
  double covariance_turn_share = 0.018;
  /// rotation sigma above which earlier pose errors in the map matter: a variance v is inflated to
  /// v (1 + v / this^2); 0: the map's rotation is exact
  double covariance_map_turn_rad = 0.0025;
  double drift_limit = 0.01;
  /// maximum residual of an inserted sweep, in medians of the recent ones, and their number
  double insert_residual_factor = 2.0;
  int insert_residual_window = 21;
  /// below this many points the map is initializing: sweeps are inserted without a match
  std::uint32_t founding_points = 300;
  double insert_distance_m = 0.0;
  double insert_rotation_rad = 0.0;
  double bridge_distance_m = 2.0;
  double bridge_rotation_rad = 0.1745;
  /// minimum share of matched points of an accepted match while bridging
  double bridge_inlier_ratio = 0.5;
  std::uint32_t bridge_sweeps = 20;
  /// way covered by a submap, m; 0: none are made
  double submap_m = 10.0;
  std::uint64_t archive_points = 20'000'000;
  std::string spill_directory;
  VoxelPlanesConfig voxel_planes;
};

}  // namespace zloam::mapping
