// Fits planes and distributions to the points counted in the map.

#include <algorithm>
#include <cmath>

#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {

// Centre of the cell's voxel at a level, relative to its root's centre.
Eigen::Vector3d VoxelPlaneMap::voxel_offset(const Cell& c, int level) const {
  const int bits = shift_ - level;
  const int mask = (1 << shift_) - 1;
  const double edge = leaf_m_ * (1 << bits);
  const auto offset = [&](int cell) {
    return (((cell & mask) >> bits) + 0.5) * edge - 0.5 * config_.root_voxel_m;
  };
  return {offset(c.x), offset(c.y), offset(c.z)};
}

void VoxelPlaneMap::Rings::add(const Rings& other) {
  if (other.ring == ring) {
    lead += other.lead;
  } else if (other.lead > lead) {
    *this = {other.ring, other.lead - lead};
  } else {
    lead -= other.lead;
  }
}

bool VoxelPlaneMap::enough(const Rings& rings, double count) const {
  return rings.lead < count || !config_.planes_several_rings;
}

// Whether the plane is a phantom: a line and a few points beside it always lie in a plane, such as
// the trace of one ring across the floor and points of other rings on the wall next to it. A real
// surface seen at a slant is thinner than the trace of a beam that faces it, because the noise is
// along the beam.
bool VoxelPlaneMap::is_trace(const PrincipalAxes& axes, const Rings& rings, double count) const {
  const double thick_m = config_.one_ring_thickness_sigmas * config_.range_noise_m;
  return config_.planes_several_rings && rings.lead > config_.one_ring_lead * count &&
         axes.variances[0] >= thick_m * thick_m;
}

std::uint32_t VoxelPlaneMap::next_fit(std::uint32_t count) const {
  const double grown = std::ceil(count * config_.refit_growth);
  return std::max(count + 1, static_cast<std::uint32_t>(std::min(grown, 4e9)));
}

// Changes the voxel's kind: releases the storage of its former fit and takes storage for the new.
void VoxelPlaneMap::set_kind(Counted& voxel, Kind kind) {
  const Counted before = voxel;
  voxel.kind = kind;
  if (before.is_plane() && !voxel.is_plane()) planes_.release(before.fit);
  if (before.is_distribution() && !voxel.is_distribution()) rows_.release(before.fit);
  if (!before.is_plane() && voxel.is_plane()) voxel.fit = planes_.take();
  if (!before.is_distribution() && voxel.is_distribution()) voxel.fit = rows_.take();
}

void VoxelPlaneMap::set_plane(Counted& voxel, const PrincipalAxes& axes, double count,
                              const Eigen::Vector3d& offset) {
  const Eigen::Vector3d n = axes.axes.col(0);
  set_kind(voxel, voxel.kind == Kind::kSettledPlane ? Kind::kSettledPlane : Kind::kPlane);
  planes_[voxel.fit] = {
      {static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z()),
       static_cast<float>(n.dot(axes.centre + offset))},
      static_cast<float>(axes.normal_variance(count))};
}

void VoxelPlaneMap::fit_node(Node& node, const Cell& cell, int level) {
  node.refit_at = next_fit(node.count);
  if (node.count >= config_.min_points && enough(node.rings(), node.count)) {
    const PrincipalAxes axes = principal_axes(Moments(node.count, node.sums));
    if (is_plane(axes, node.count, own_gates_) && !is_trace(axes, node.rings(), node.count)) {
      set_plane(node, axes, node.count, voxel_offset(cell, level));
      return;
    }
    if (is_post(axes, node, level)) {
      set_distribution(node, Kind::kLine, axes, voxel_offset(cell, level));
      return;
    }
  }
  set_kind(node, Kind::kNone);
}

// Any surface that the voxel's faces cut off looks narrow, and would confirm any position. So a
// post keeps a margin to all faces but those that its axis passes through.
bool VoxelPlaneMap::is_post(const PrincipalAxes& axes, const Node& node, int level) const {
  const Eigen::Vector3d& v = axes.variances;
  if (!config_.distributions || v[1] > config_.post_width_m * config_.post_width_m ||
      v[2] < config_.post_aspect * config_.post_aspect * v[1] ||
      node.lead > config_.post_lead * node.count) {
    return false;
  }
  const Eigen::Vector3d axis = axes.axes.col(2);
  const double half_m = 0.5 * config_.root_voxel_m / (1 << level);
  for (int i = 0; i < 3; ++i) {
    if (std::abs(axis[i]) > 0.7) continue;
    const double wide = std::sqrt(v[0] * axes.axes(i, 0) * axes.axes(i, 0) +
                                  v[1] * axes.axes(i, 1) * axes.axes(i, 1));
    const double along = std::abs(axis[i]) * std::sqrt(3.0 * v[2]);
    if (std::abs(axes.centre[i]) + along + config_.post_margin_sigmas * wide > half_m) return false;
  }
  return true;
}

// Parents of a finest voxel and its 26 neighbours: two on each axis. Most lie in the cell's own
// root.
std::array<const VoxelPlaneMap::Node*, 8> VoxelPlaneMap::parents_around(const Cell& cell) const {
  const std::uint64_t own_key = root_key(cell);
  const std::uint32_t own = find_root(own_key);
  std::array<const Node*, 8> parents{};
  for (unsigned p = 0; p < 8; ++p) {
    const auto step = [p](unsigned axis) { return (p >> axis & 1U) != 0 ? 1 : -1; };
    const Cell corner{cell.x + step(0), cell.y + step(1), cell.z + step(2)};
    const std::uint64_t key = root_key(corner);
    std::uint32_t i = key == own_key ? own : find_root(key);
    for (int bit = shift_ - 1; i != kNoChild && bit > 0; --bit) {
      i = nodes_[i].children[octant(corner, bit)];
    }
    parents[p] = i == kNoChild ? nullptr : &nodes_[i];
  }
  return parents;
}

// Finds those of the 26 neighbours that hold points, and prefetches them.
std::size_t VoxelPlaneMap::neighbours_of(const Cell& cell, std::array<Neighbour, 26>& found) const {
  const std::array<const Node*, 8> parents = parents_around(cell);
  const auto upper = [](int at, int step) { return (at + step) >> 1 != (at - 1) >> 1 ? 1U : 0U; };
  std::size_t count = 0;
  for (int x = -1; x <= 1; ++x) {
    for (int y = -1; y <= 1; ++y) {
      const unsigned column = upper(cell.x, x) | upper(cell.y, y) << 1;
      for (int z = -1; z <= 1; ++z) {
        const Node* parent = parents[column | upper(cell.z, z) << 2];
        if (parent == nullptr || (x == 0 && y == 0 && z == 0)) continue;
        const std::uint32_t child =
            parent->children[octant({cell.x + x, cell.y + y, cell.z + z}, 0)];
        if (child == kNoChild) continue;
        leaves_.fetch(child);
        found[count++] = {child, {x, y, z}};
      }
    }
  }
  return count;
}

Moments VoxelPlaneMap::merged_moments(const Leaf& leaf, const Cell& cell, Rings& rings) const {
  Moments all(leaf.count, leaf.sums);
  const Eigen::Vector3d mean = all.mean();
  const double reach = config_.merge_radius_voxels * leaf_m_;
  std::array<Neighbour, 26> found;
  const std::size_t count = neighbours_of(cell, found);
  for (const Neighbour& neighbour : std::span(found).first(count)) {
    const Leaf& other = leaves_[neighbour.leaf];
    const Moments moments(other.count, other.sums);
    const Eigen::Vector3d offset = neighbour.step.cast<double>() * leaf_m_;
    if ((moments.mean() + offset - mean).squaredNorm() <= reach * reach) {
      all.add(moments, offset);
      rings.add(other.rings());
    }
  }
  return all;
}

void VoxelPlaneMap::fit_leaf(Leaf& leaf, const Cell& cell) {
  leaf.refit_at = next_fit(leaf.count);
  const Eigen::Vector3d offset = voxel_offset(cell, shift_);
  PrincipalAxes own;
  if (leaf.count >= config_.min_points) {
    own = principal_axes(Moments(leaf.count, leaf.sums));
    if (enough(leaf.rings(), leaf.count) && is_plane(own, leaf.count, own_gates_) &&
        !is_trace(own, leaf.rings(), leaf.count)) {
      set_plane(leaf, own, leaf.count, offset);
      return;
    }
  }
  if (config_.merge_radius_voxels > 0.0) {
    Rings rings = leaf.rings();
    const Moments moments = merged_moments(leaf, cell, rings);
    if (moments.count >= config_.min_points && enough(rings, moments.count)) {
      const PrincipalAxes merged = principal_axes(moments);
      if (is_plane(merged, moments.count, merged_gates_) &&
          !is_trace(merged, rings, moments.count)) {
        set_plane(leaf, merged, moments.count, offset);
        return;
      }
    }
  }
  const bool seen = leaf.several_rings() || !config_.distributions_several_rings;
  if (config_.distributions && seen && leaf.count >= config_.min_points) {
    fit_distribution(leaf, own, offset);
  } else {
    set_kind(leaf, Kind::kNone);
  }
}

// The rows are the axes of the distribution: those of the square root of the inverse of (covariance
// + noise), times the noise. A line leaves its long axis unconstrained.
void VoxelPlaneMap::fit_distribution(Leaf& leaf, const PrincipalAxes& axes,
                                     const Eigen::Vector3d& offset) {
  const bool is_line =
      axes.variances[1] < own_gates_.min_width2 && axes.variances[2] > 16.0 * axes.variances[1];
  set_distribution(leaf, is_line ? Kind::kLine : Kind::kBlob, axes, offset);
}

void VoxelPlaneMap::set_distribution(Counted& voxel, Kind kind, const PrincipalAxes& axes,
                                     const Eigen::Vector3d& offset) {
  const double noise = config_.range_noise_m;
  set_kind(voxel, kind);
  for (int i = 0; i < (kind == Kind::kLine ? 2 : 3); ++i) {
    const Eigen::Vector3d n =
        axes.axes.col(i) * (noise / std::sqrt(axes.variances[i] + noise * noise));
    rows_[voxel.fit][static_cast<std::size_t>(i)] = {
        static_cast<float>(n.x()), static_cast<float>(n.y()), static_cast<float>(n.z()),
        static_cast<float>(n.dot(axes.centre + offset))};
  }
}

}  // namespace zloam::plane_map
