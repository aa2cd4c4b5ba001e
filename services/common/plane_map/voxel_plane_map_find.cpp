// Looks up planes. Many points at once are sorted into the order of the octree first, so that each
// voxel is visited once for all of its points.

#include <algorithm>

#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {
namespace {

// The axis of the grid that is closest to the surface's normal.
std::size_t widest_axis(const PlaneRow& row) {
  const float x = std::abs(row.nx), y = std::abs(row.ny), z = std::abs(row.nz);
  if (x >= y && x >= z) return 0;
  return y >= z ? 1 : 2;
}

}  // namespace

Float4 VoxelPlaneMap::root_lanes(const Cell& cell) const {
  const std::array<float, 3> root = root_centre(cell);
  return Float4{root[0], root[1], root[2], 1.0f};
}

// The match with a voxel that has a plane or a distribution.
inline Match VoxelPlaneMap::match_of(const Counted& voxel, Float4 root) const {
  if (voxel.is_plane()) {
    const Plane& plane = planes_[voxel.fit];
    return {&plane.row, 1, true, plane.normal_variance, 0.0f, root};
  }
  const int count = voxel.kind == Kind::kLine ? 2 : 3;
  return {rows_[voxel.fit].data(), count, false, 0.0f, 0.0f, root};
}

Match VoxelPlaneMap::find(float x, float y, float z) {
  const LocalPoint point{x, y, z};
  return has_cell(point.lanes()) ? look_up(cell_of(point)) : Match();
}

void VoxelPlaneMap::look_up(Float4 point, Hint& hint) {
  const float crowd = hint.match.crowd;
  hint = Hint();
  if (has_cell(point)) {
    const Int4 cell = cell_lanes(point);
    hint = {centre_of(cell), look_up(cell_of(cell))};
  }
  hint.match.crowd = crowd;
}

Match VoxelPlaneMap::look_up(const Cell& cell) {
  const Float4 root = root_lanes(cell);
  std::uint32_t i = find_root(root_key(cell));
  Match post;
  for (int bit = shift_ - 1; bit >= 0 && i != kNoChild; --bit) {
    const Node& node = fitted_node(i, cell, shift_ - 1 - bit);
    if (node.is_plane()) return match_of(node, root);
    if (node.kind == Kind::kLine) post = match_of(node, root);
    i = node.children[octant(cell, bit)];
  }
  return i == kNoChild ? post : match_of_leaf(i, cell, root, post);
}

VoxelPlaneMap::Node& VoxelPlaneMap::fitted_node(std::uint32_t index, const Cell& cell, int level) {
  Node& node = nodes_[index];
  if (node.count >= node.refit_at) fit_node(node, cell, level);
  return node;
}

// post: the match with a coarser voxel, for a finest voxel without a fit of its own.
Match VoxelPlaneMap::match_of_leaf(std::uint32_t index, const Cell& cell, Float4 root,
                                   const Match& post) {
  Leaf& leaf = leaves_[index];
  if (leaf.count >= leaf.refit_at) {
    fit_leaf(leaf, cell);
  }
  return leaf.kind == Kind::kNone ? post : match_of(leaf, root);
}

// Fills found_: first descends to all finest voxels, which prefetches their memory, then fits and
// matches them.
void VoxelPlaneMap::find_in_root(const RootHit& hit, std::span<const LocalPoint> points) {
  found_.clear();
  const Float4 root = root_lanes(hit.cell);
  if (hit.node == kNoChild) {
    found_.push_back({hit.points, kNoChild, {}});
  } else {
    find_in_node(hit.node, 0, hit.points, points, root, {});
  }
  for (Found& found : found_) {
    if (found.leaf == kNoChild) continue;
    const Cell cell = cell_of(points[found.points.front().point]);
    found.match = match_of_leaf(found.leaf, cell, root, found.match);
  }
}

void VoxelPlaneMap::find_in_node(std::uint32_t index, int level, std::span<const Placed> placed,
                                 std::span<const LocalPoint> points, Float4 root,
                                 const Match& post) {
  const Node& node = fitted_node(index, cell_of(points[placed.front().point]), level);
  const Match match = node.kind == Kind::kNone ? post : match_of(node, root);
  if (node.is_plane()) {
    found_.push_back({placed, kNoChild, match});
    return;
  }
  const int bit = shift_ - 1 - level;
  while (!placed.empty()) {
    const std::span<const Placed> part = together(placed, bit);
    placed = placed.subspan(part.size());
    const std::uint32_t child = node.children[octant_of(part.front(), bit)];
    if (child != kNoChild && bit > 0) {
      find_in_node(child, level + 1, part, points, root, match);
      continue;
    }
    if (child != kNoChild) leaves_.fetch(child);
    found_.push_back({part, child, match});
  }
}

void VoxelPlaneMap::count_crowds() {
  std::array<float, 3> facing{};
  for (const Found& found : found_) {
    if (found.match.count == 0) continue;
    facing[widest_axis(*found.match.rows)] += static_cast<float>(found.points.size());
  }
  for (Found& found : found_) {
    if (found.match.count > 0) found.match.crowd = facing[widest_axis(*found.match.rows)];
  }
}

void VoxelPlaneMap::find_all(std::span<const LocalPoint> points, std::span<Hint> hints) {
  hit_roots(points, false);
  if (placed_.size() < points.size()) std::fill(hints.begin(), hints.end(), Hint());
  for (std::size_t i = 0; i < roots_hit_.size(); ++i) {
    fetch_root(i + kAhead);
    find_in_root(roots_hit_[i], points);
    count_crowds();
    for (const Found& found : found_) {
      for (const Placed& p : found.points) {
        hints[p.point] = {centre_of(cell_lanes(points[p.point].lanes())), found.match};
      }
    }
  }
}

void VoxelPlaneMap::fetch_root(std::size_t hit) const {
  if (hit < roots_hit_.size() && roots_hit_[hit].node != kNoChild) {
    nodes_.fetch(roots_hit_[hit].node);
  }
}

}  // namespace zloam::plane_map
