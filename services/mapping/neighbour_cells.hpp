#pragma once
// Nearest neighbours among points that move a little: the points of cells somewhat larger than the
// search radius, so that a cell and its 26 neighbours hold all that can be found.

#include <algorithm>
#include <cstdint>
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

struct Neighbour {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  double squared_m2 = 0.0;
  RingRange rings;
};

class NeighbourCells {
 public:
  /// radius_m: the farthest that nearest() will be asked for; margin_m: how far a point can lie
  /// from the place that it was added at.
  NeighbourCells(double radius_m, double margin_m);

  /// A point, known by a number of the caller's, at a place (frame map) that chooses its cell.
  void add(std::uint32_t id, const Eigen::Vector3d& place_map, const RingRange& rings);
  void move(std::uint32_t id, const Eigen::Vector3d& point_map, const RingRange& rings);
  void remove(std::uint32_t id);

  /// The out.size() nearest points, ascending by distance (ties: by the order of calls). Returns
  /// how many lie within radius_m.
  std::size_t nearest(const Eigen::Vector3d& point_map, double radius_m,
                      std::span<Neighbour> out) const;

 private:
  struct Entry {
    /// from the cell's centre: short, so float is enough
    Eigen::Vector3f offset;
    std::uint32_t id;
    RingRange rings;
  };
  struct Cell {
    std::uint64_t key = 0;
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    std::vector<Entry> entries;
  };
  struct Place {
    std::uint32_t cell = 0;
    std::uint32_t in_cell = 0;
  };

  std::uint32_t cell_at(const Eigen::Vector3d& place_map);

  double margin_m_;
  double edge_m_;
  std::vector<Cell> cells_;
  std::vector<std::uint32_t> free_cells_;
  FlatIndex index_;
  /// by id
  std::vector<Place> places_;
};

}  // namespace zloam::mapping
