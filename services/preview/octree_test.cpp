// Cells and octrees compared with sets of indices that are computed individually.

#include "preview/octree.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <set>
#include <vector>

namespace zloam::preview {
namespace {

using Index = std::array<int, 3>;

std::vector<MapPoint> scattered(const CubeIndex& cube, double edge_m, int count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> within(0.0, edge_m);
  std::vector<MapPoint> points;
  for (int n = 0; n < count; ++n) {
    points.push_back({static_cast<float>(edge_m * cube.i + within(random)),
                      static_cast<float>(edge_m * cube.j + within(random)),
                      static_cast<float>(edge_m * cube.k + within(random)), 0.0F});
  }
  return points;
}

/// Indices in the grid of the whole map.
std::set<Index> voxelised(const std::vector<MapPoint>& points, double cell_m) {
  std::set<Index> cells;
  for (const MapPoint& p : points) {
    cells.insert({static_cast<int>(std::floor(p.x / cell_m)),
                  static_cast<int>(std::floor(p.y / cell_m)),
                  static_cast<int>(std::floor(p.z / cell_m))});
  }
  return cells;
}

/// Decodes node by node, as the schema defines; empty if the bytes are no octree.
std::set<Index> decoded(const std::vector<std::uint8_t>& bytes, const CubeIndex& cube, int depth) {
  std::vector<Index> nodes;
  if (!bytes.empty()) nodes.push_back({cube.i, cube.j, cube.k});
  std::size_t at = 0;
  for (int level = 0; level < depth; ++level) {
    std::vector<Index> children;
    for (const Index& node : nodes) {
      if (at == bytes.size()) return {};
      for (int bit = 0; bit < 8; ++bit) {
        if ((bytes[at] >> bit & 1) == 0) continue;
        children.push_back(
            {2 * node[0] + (bit & 1), 2 * node[1] + (bit >> 1 & 1), 2 * node[2] + (bit >> 2)});
      }
      ++at;
    }
    nodes = std::move(children);
  }
  if (at != bytes.size()) return {};
  return {nodes.begin(), nodes.end()};
}

TEST(Octree, HasTheCellsOfThePointsAtEachSize) {
  constexpr double kEdge_m = 50.0;
  constexpr int kDepth = 8;
  for (const CubeIndex cube : {CubeIndex{0, 0, 0}, CubeIndex{-1, 3, -2}, CubeIndex{7, -20, 0}}) {
    const auto points = scattered(cube, kEdge_m, 3000, 5);
    const auto cells = cells_of(points, cube, kEdge_m, kDepth);
    for (int depth = 1; depth <= kDepth; ++depth) {
      const auto found = decoded(octree(coarser(cells, kDepth, depth), depth), cube, depth);
      EXPECT_EQ(found, voxelised(points, std::ldexp(kEdge_m, -depth))) << depth;
    }
  }
}

TEST(Octree, OfOnePointHasOneByteALevel) {
  const std::vector<MapPoint> one = {{0.9F, 0.1F, 0.9F, 0.0F}};
  // In a cube of 1 m the point is in the upper half on x and z, the lower on y, at each level.
  const auto bytes = octree(cells_of(one, {0, 0, 0}, 1.0, 3), 3);
  EXPECT_EQ(bytes, (std::vector<std::uint8_t>{1U << 5, 1U << 5, 1U << 5}));
}

TEST(Octree, OfNothingIsEmpty) {
  EXPECT_TRUE(octree({}, 6).empty());
  EXPECT_TRUE(cells_of({}, {0, 0, 0}, 50.0, 8).empty());
}

TEST(Octree, OfAFloorCostsAThirdOfAByteACell) {
  std::vector<MapPoint> floor;
  for (int x = 0; x < 256; ++x) {
    for (int y = 0; y < 256; ++y) {
      floor.push_back({static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 0.5F, 0.0F});
    }
  }
  const auto cells = cells_of(floor, {0, 0, 0}, 256.0, 8);
  ASSERT_EQ(cells.size(), 65536U);
  // 1 + 4 + 16 + ... + 4^7
  EXPECT_EQ(octree(cells, 8).size(), 21845U);
}

TEST(Cells, BeyondTheCubeAreItsOutermost) {
  const std::vector<MapPoint> beyond = {{-1e-3F, 60.0F, 25.0F, 0.0F}};
  const auto cells = cells_of(beyond, {0, 0, 0}, 50.0, 1);
  // Lower half on x, upper half on y and z.
  EXPECT_EQ(cells, std::vector<Cell>{6U});
}

TEST(Below, IsTheCubeThatACellIs) {
  const CubeIndex cube{-1, 2, 0};
  const std::vector<MapPoint> one = {{-0.3F, 2.6F, 0.1F, 0.0F}};
  const Cell cell = cells_of(one, cube, 1.0, 2).front();
  EXPECT_EQ(below(cube, cell, 2), (CubeIndex{-2, 10, 0}));
}

}  // namespace
}  // namespace zloam::preview
