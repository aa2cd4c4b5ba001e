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

/// A cell within its cube: three bits for each halving of the cube's edge, those of the first
/// halving highest; of these z is the highest one, x the lowest.
using Cell = std::uint32_t;

/// A cube has at most 256 cells along an edge.
inline constexpr int kMostDepth = 8;

/// Ascending, each once. A point that lies outside by its rounding counts for the nearest cell.
std::vector<Cell> cells_of(std::span<const MapPoint> points, const CubeIndex& cube, double edge_m,
                           int depth);

/// The larger cells of `to` halvings in which cells of `from` halvings lie.
std::vector<Cell> coarser(std::span<const Cell> cells, int from, int to);

/// Cells of `depth` halvings as the bytes of the schema; empty without cells.
std::vector<std::uint8_t> octree(std::span<const Cell> cells, int depth);

/// The cube of `depth` halvings below another one that a cell is.
CubeIndex below(const CubeIndex& cube, Cell cell, int depth);

}  // namespace zloam::preview
