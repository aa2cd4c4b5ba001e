#pragma once
// The map: both layers, the window of tiles that follows the sensor, and an archive of tiles that
// left it.

#include <map>

#include "mapping/layer_map.hpp"
#include "mapping/tile_archive.hpp"

namespace zloam::mapping {

class TileMap {
 public:
  explicit TileMap(const MappingConfig& config);

  /// Shifts the window: tiles that leave it go to the archive and are returned as they were; tiles
  /// that enter again are taken back from the archive.
  std::vector<Tile> follow(const Eigen::Vector3d& sensor_map);
  /// Inserts points given in base_link.
  void insert(Layer layer, PointSpan points_base, const Pose& T_map_base);
  /// Tiles changed since the last call, ascending; their versions grow by one.
  std::vector<TileId> take_changed();

  /// Restores a tile of another instance; does not count as a change.
  void restore(const Tile& tile);

  std::optional<Tile> tile(const TileId& id) const;
  /// All points ever counted in a tile of the window; 0: there is no such tile.
  std::uint64_t count(const TileId& id) const { return layer(id.layer).tile_count(id.index); }
  /// Ascending, including the archived ones.
  std::vector<TileId> tiles() const;
  std::vector<TileId> local_tiles() const;
  std::size_t point_count() const;
  const TileArchive& archive() const { return archive_; }
  /// Points too far from the origin for the voxels' indices.
  std::uint64_t left_out() const { return layers_[0].left_out() + layers_[1].left_out(); }

 private:
  bool within(const TileIndex& index, const std::array<int, 3>& extent) const;
  const LayerMap& layer(Layer layer) const { return layers_[static_cast<std::size_t>(layer)]; }
  LayerMap& layer(Layer layer) { return layers_[static_cast<std::size_t>(layer)]; }

  double tile_edge_m_;
  std::array<int, 3> window_;
  std::array<int, 3> local_;
  TileIndex centre_;
  std::array<LayerMap, 2> layers_;
  TileArchive archive_;
  std::vector<NewPoint> new_points_;  // points of one sweep while they are inserted
};

}  // namespace zloam::mapping
