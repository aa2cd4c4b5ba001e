#include "preview/octree.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::preview {
namespace {

/// Index along one axis in the grid of the whole map, so that cells of all sizes are aligned to it.
std::uint32_t index_of(float value_m, double cell_m, std::int32_t cube, int depth) {
  const double cells = std::ldexp(1.0, depth);
  const double index = std::floor(static_cast<double>(value_m) / cell_m) - cells * cube;
  return static_cast<std::uint32_t>(std::clamp(index, 0.0, cells - 1.0));
}

/// Inserts two zero bits before each bit of a byte.
Cell spread(std::uint32_t index) {
  Cell bits = index;
  bits = (bits | bits << 8) & 0x00F00FU;
  bits = (bits | bits << 4) & 0x0C30C3U;
  bits = (bits | bits << 2) & 0x249249U;
  return bits;
}

void sort_unique(std::vector<Cell>& cells) {
  std::sort(cells.begin(), cells.end());
  cells.erase(std::unique(cells.begin(), cells.end()), cells.end());
}

}  // namespace

std::vector<Cell> cells_of(std::span<const MapPoint> points, const CubeIndex& cube, double edge_m,
                           int depth) {
  const double cell_m = std::ldexp(edge_m, -depth);
  std::vector<Cell> cells;
  cells.reserve(points.size());
  for (const MapPoint& p : points) {
    cells.push_back(spread(index_of(p.x, cell_m, cube.i, depth)) |
                    spread(index_of(p.y, cell_m, cube.j, depth)) << 1 |
                    spread(index_of(p.z, cell_m, cube.k, depth)) << 2);
  }
  sort_unique(cells);
  return cells;
}

std::vector<Cell> coarser(std::span<const Cell> cells, int from, int to) {
  std::vector<Cell> larger;
  for (const Cell cell : cells) {
    const Cell around = cell >> 3 * (from - to);
    if (larger.empty() || larger.back() != around) larger.push_back(around);
  }
  return larger;
}

std::vector<std::uint8_t> octree(std::span<const Cell> cells, int depth) {
  std::vector<std::uint8_t> bytes;
  for (int level = 1; level <= depth; ++level) {
    Cell parent = 0;
    bool first = true;
    for (const Cell child : coarser(cells, depth, level)) {
      if (first || child >> 3 != parent) bytes.push_back(0);
      first = false;
      parent = child >> 3;
      bytes.back() = static_cast<std::uint8_t>(bytes.back() | 1U << (child & 7U));
    }
  }
  return bytes;
}

CubeIndex below(const CubeIndex& cube, Cell cell, int depth) {
  CubeIndex found = cube;
  for (int level = depth - 1; level >= 0; --level) {
    const Cell half = cell >> 3 * level;
    found = {2 * found.i + static_cast<std::int32_t>(half & 1U),
             2 * found.j + static_cast<std::int32_t>(half >> 1 & 1U),
             2 * found.k + static_cast<std::int32_t>(half >> 2 & 1U)};
  }
  return found;
}

}  // namespace zloam::preview
