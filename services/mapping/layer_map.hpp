#pragma once
// One layer of the map: counted voxels, found by nearest neighbour and handed out by tile.
//
// A voxel keeps the number and the sum of all points that ever fell into it, so that its mean gets
// better with each of them. (A voxel filter run again over old centroids and new points weighs the
// whole past like one new point: such a map forgets.) The voxels' grid is turned and shifted
// against the map's axes, because a floor or wall that lies on the boundary of two layers of voxels
// would be split into two half-noise surfaces.

#include <algorithm>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "mapping/flat_index.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Rings that hit a voxel, lowest and highest. The default is that of a voxel whose rings are not
/// known any more: taken for several.
struct RingRange {
  std::uint16_t low = 0;
  std::uint16_t high = 0xffff;
  static RingRange of(std::uint16_t ring) { return {ring, ring}; }
  void join(const RingRange& other) {
    low = std::min(low, other.low);
    high = std::max(high, other.high);
  }
  bool single() const { return low == high; }
};

/// A voxel's mean (m, frame map) and how many points made it.
struct CountedPoint {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  std::uint32_t count = 0;
  float intensity = 0.0F;
};

struct Neighbour {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  double squared_m2 = 0.0;
  RingRange rings;
};

class LayerMap {
 public:
  /// leaf_m: edge of a voxel; radius_m: the farthest that nearest() will be asked for.
  LayerMap(double leaf_m, double tile_edge_m, double radius_m);

  LayerMap(LayerMap&&) noexcept = default;
  LayerMap& operator=(LayerMap&&) noexcept = default;
  LayerMap(const LayerMap&) = delete;
  LayerMap& operator=(const LayerMap&) = delete;

  /// Points (frame map) that are not finite or farther than 100 km from the origin are left out.
  void insert(const Eigen::Vector3d& point_map, float intensity, const RingRange& rings = {},
              std::uint32_t count = 1);

  /// The out.size() nearest voxel means, ascending by distance (ties: by their place in the map,
  /// which only depends on the order of insertion). Returns how many lie within radius_m.
  std::size_t nearest(const Eigen::Vector3d& point_map, double radius_m,
                      std::span<Neighbour> out) const;

  /// Tiles changed since the last call, ascending; their versions grow by one.
  std::vector<TileIndex> take_changed();

  /// Takes a tile out of the map, returns its points in order of insertion.
  std::vector<CountedPoint> remove_tile(const TileIndex& index);
  /// Puts a tile back; its version continues from the given one. Does not count as a change.
  void restore_tile(const TileIndex& index, std::uint64_t version,
                    std::span<const CountedPoint> points);

  std::vector<CountedPoint> tile_points(const TileIndex& index) const;
  std::uint64_t tile_version(const TileIndex& index) const;
  /// Ascending; only tiles that hold points.
  std::vector<TileIndex> tiles() const;
  TileIndex tile_of(const Eigen::Vector3d& point_map) const;
  std::size_t point_count() const { return live_; }

 private:
  struct TileRecord {
    TileIndex index;
    std::uint64_t version = 0;
    bool changed = false;
    std::vector<std::uint32_t> voxels;
  };
  struct Voxel {
    std::uint64_t key = 0;
    Eigen::Vector3d anchor = Eigen::Vector3d::Zero();  // the first point
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();     // of the offsets from the anchor
    std::uint32_t count = 0;
    float intensity_sum = 0.0F;
    std::uint32_t cell = 0;
    std::uint32_t place_in_cell = 0;
    TileRecord* tile = nullptr;
    Eigen::Vector3d mean() const { return anchor + sum / static_cast<double>(count); }
  };
  struct CellEntry {
    Eigen::Vector3f
        offset;  // of the voxel's mean from the cell's centre: short, so float is enough
    std::uint32_t voxel;
    RingRange rings;
  };
  struct Cell {
    std::uint64_t key = 0;
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    std::vector<CellEntry> entries;
  };

  std::uint32_t voxel_at(const Eigen::Vector3d& point_map, const RingRange& rings);
  std::uint32_t found_voxel(std::uint64_t key, const Eigen::Vector3d& centre_map,
                            const Eigen::Vector3d& point_map, const RingRange& rings);
  std::uint32_t cell_at(const Eigen::Vector3d& centre_map);
  void move_to_tile(std::uint32_t id, const TileIndex& index);
  TileRecord& record(const TileIndex& index);
  void touch(TileRecord& tile);
  void drop_voxel(std::uint32_t id);

  double leaf_m_;
  double tile_edge_m_;
  double margin_m_;  // how far a mean can lie from its voxel's centre
  double cell_edge_m_;
  Eigen::Matrix3d R_grid_map_;
  std::vector<Voxel> voxels_;
  std::vector<std::uint32_t> free_voxels_;
  FlatIndex voxel_index_;
  std::vector<Cell> cells_;
  std::vector<std::uint32_t> free_cells_;
  FlatIndex cell_index_;
  std::map<TileIndex, TileRecord> tiles_;
  std::vector<TileIndex> changed_;
  std::size_t live_ = 0;
};

}  // namespace zloam::mapping
