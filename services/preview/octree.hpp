#pragma once
// Occupied cells of a cube, as numbers and as an octree (schemas/preview.fbs). An octree of a map
// is small: surfaces fill about four of the eight halves of a cube, so that a cell of the finest
// level costs a third of a byte; and its first levels are the same map with larger cells.

#include <compare>
#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/point.hpp"

namespace zloam::preview {

/// The cube spans [i, i + 1) * edge on x, likewise y and z, frame map.
struct CubeIndex {
  std::int32_t i = 0, j = 0, k = 0;
  auto operator<=>(const CubeIndex&) const = default;
};

/// A cell within its cube: three bits for each halving of the cube's edge, the first halving in the
/// highest bits; of the three bits z is the highest, x the lowest.
using Cell = std::uint32_t;

/// A cube has at most 256 cells along an edge.
inline constexpr int kMostDepth = 8;

/// Ascending, without duplicates. A point just outside (rounding) counts for the nearest cell.
std::vector<Cell> cells_of(std::span<const MapPoint> points, const CubeIndex& cube, double edge_m,
                           int depth);

/// The cells of `to` halvings that contain the given cells of `from` halvings.
std::vector<Cell> coarser(std::span<const Cell> cells, int from, int to);

/// Encodes cells of `depth` halvings as in the schema; empty without cells.
std::vector<std::uint8_t> octree(std::span<const Cell> cells, int depth);

/// The cell as a cube of its own, `depth` halvings below the given cube.
CubeIndex below(const CubeIndex& cube, Cell cell, int depth);

}  // namespace zloam::preview
