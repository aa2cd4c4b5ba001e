#pragma once
// A map to localize in, of the cubes of single maps: mapping's points and voxels, moved by the
// correction of the submap that saw them first, and counted again in the merged map's grid. What
// moved is left out (seen_places.hpp).

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "mapping/layer_map.hpp"
#include "mapping/voxel_tiles.hpp"
#include "sessions/drawn_points.hpp"
#include "sessions/seen_places.hpp"

namespace zloam::sessions {

/// Sizes of the cubes and voxels of a stored map; a stage with other voxels refuses it.
struct MapSizes {
  double tile_edge_m = 0.0;
  double root_voxel_m = 0.0;
  int levels = 0;
  double range_noise_m = 0.0;
};

/// The cubes of one map as its mapping left them, and what to do with them.
struct MapPart {
  const std::vector<mapping::Tile>& tiles;
  const std::vector<mapping::VoxelTile>& voxels;
  const SeenPlaces& places;
  /// for each submap the pose of the map by this submap's correction
  std::vector<Pose> T_world_map;
};

class MapBuilder {
 public:
  explicit MapBuilder(const MapSizes& sizes);

  /// Of each map the first half is added, then of each map the second one: planes that are known
  /// well by then drop their finer voxels, as in mapping.
  enum class Half : std::uint8_t { kFirst, kSecond };
  void add_voxels(const MapPart& part, Half half);
  /// Those of all maps, joined in voxels of 0.1 m, or of the double, and so on, until no cube has
  /// more than this many, and none lies too far from the origin for the voxels' indices.
  void add_points(std::span<const MapPart> parts, std::size_t most_in_cube);

  /// All of them, ascending.
  std::vector<mapping::Tile> tiles() const;
  std::vector<mapping::VoxelTile> voxels() const;

 private:
  static void add_points(const MapPart& part, Layer which, mapping::LayerMap& layer);
  void draw(const Patch& patch, const Pose& T_grid_grid, Half half);

  double tile_edge_m_;
  std::array<mapping::LayerMap, 2> layers_;
  plane_map::VoxelPlaneMap voxels_;
  UnitClouds clouds_;
  // Of the cube that is added.
  std::vector<plane_map::LocalPoint> local_;
  std::vector<plane_map::VoxelPlaneMap::Hint> hints_;
};

}  // namespace zloam::sessions
