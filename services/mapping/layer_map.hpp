#pragma once
// One layer of the map: counted voxels, handed out by tile.
//
// A voxel keeps the number and the sum of all points that ever fell into it, so that its mean gets
// better with each of them. (A voxel filter run again over old centroids and new points weighs the
// whole past like one new point: such a map forgets.) The voxels' grid is rotated and shifted
// against the map's axes, because a floor or wall on the boundary of two layers of voxels would be
// split into two half-noise surfaces.

#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "common/containers/flat_index.hpp"
#include "common/containers/pool.hpp"
#include "mapping/grid_index.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// A voxel's mean (m, frame map) and the number of its points.
struct CountedPoint {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  std::uint32_t count = 0;
  float intensity = 0.0F;
};

/// A point to be counted (m, frame map).
struct NewPoint {
  Eigen::Vector3d position;
  float intensity = 0.0F;
};

class LayerMap {
 public:
  /// leaf_m: edge of a voxel.
  LayerMap(double leaf_m, double tile_edge_m);

  LayerMap(LayerMap&&) noexcept = default;
  LayerMap& operator=(LayerMap&&) noexcept = default;
  LayerMap(const LayerMap&) = delete;
  LayerMap& operator=(const LayerMap&) = delete;

  /// Points (frame map) that are not finite are left out, and those farther from the origin than
  /// about a million voxels, which are counted. A voxel of four million points takes no more.
  void insert(const Eigen::Vector3d& point_map, float intensity, std::uint32_t count = 1);

  /// The same, one after the other.
  void insert(std::span<const NewPoint> points_map);

  /// Tiles changed since the last call, ascending; their versions grow by one.
  std::vector<TileIndex> take_changed();

  /// Removes a tile from the map and returns its points in order of insertion.
  std::vector<CountedPoint> remove_tile(const TileIndex& index);
  /// Puts a tile back; its version continues from the given one. Does not count as a change.
  void restore_tile(const TileIndex& index, std::uint64_t version,
                    std::span<const CountedPoint> points);

  std::vector<CountedPoint> tile_points(const TileIndex& index) const;
  std::uint64_t tile_version(const TileIndex& index) const;
  /// All points ever counted in the tile.
  std::uint64_t tile_count(const TileIndex& index) const;
  /// Ascending; only tiles that hold points.
  std::vector<TileIndex> tiles() const;
  TileIndex tile_of(const Eigen::Vector3d& point_map) const;
  std::size_t point_count() const { return voxels_.in_use(); }
  std::uint64_t left_out() const { return left_out_; }

 private:
  static constexpr std::uint64_t kNoKey = ~std::uint64_t{0};

  struct TileRecord {
    TileIndex index;
    std::uint64_t version = 0;
    bool changed = false;
    std::uint64_t count = 0;
    std::vector<std::uint32_t> voxels;
  };
  /// There is one for each point of the map in memory: kept small.
  struct Voxel {
    std::uint64_t key = 0;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();  // of the offsets from the voxel's centre
    std::uint32_t count = 0;
    float intensity_sum = 0.0F;
    TileRecord* tile = nullptr;
  };

  std::uint64_t key_of(const Eigen::Vector3d& point_map) const;
  void insert_at(std::uint64_t key, const NewPoint& point_map, std::uint32_t count);
  void fetch_ahead(std::size_t at) const;
  std::uint32_t voxel_at(std::uint64_t key);
  Eigen::Vector3d centre_map(const GridIndex& index) const;
  void move_to_tile(std::uint32_t id, const TileIndex& index);
  TileRecord& record(const TileIndex& index);
  void touch(TileRecord& tile);
  void drop_voxel(std::uint32_t id);

  double leaf_m_;
  double tile_edge_m_;
  Eigen::Matrix3d R_grid_map_;
  Pool<Voxel> voxels_;
  FlatIndex voxel_index_;
  std::map<TileIndex, TileRecord> tiles_;
  std::vector<TileIndex> changed_;
  std::uint64_t left_out_ = 0;
  std::vector<std::uint64_t> new_keys_;  // of the points that are being inserted
};

}  // namespace zloam::mapping
