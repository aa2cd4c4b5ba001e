// Saves and restores the counts in the map's voxels.

#include "common/geometry/grid_key.hpp"
#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {
namespace {

constexpr std::int32_t kMaxRoot = 1 << (kGridKeyBits - 2);

// Voxel: a node or a leaf.
template <typename Voxel>
void put(const Voxel& counted, SavedVoxel& out) {
  out.count = counted.count;
  out.lead = counted.lead;
  out.ring = counted.ring;
  for (std::size_t i = 0; i < 3; ++i) out.sum[i] = static_cast<float>(counted.sums.sum[i]);
  for (std::size_t i = 0; i < 6; ++i) out.squares[i] = static_cast<float>(counted.sums.squares[i]);
}

template <typename Voxel>
void take(const SavedVoxel& in, Voxel& counted) {
  counted.count = in.count;
  counted.lead = in.lead;
  counted.ring = in.ring;
  for (std::size_t i = 0; i < 3; ++i) counted.sums.sum[i] = in.sum[i];
  for (std::size_t i = 0; i < 6; ++i) counted.sums.squares[i] = in.squares[i];
}

}  // namespace

std::vector<RootSummary> VoxelPlaneMap::roots() const {
  std::vector<RootSummary> out;
  out.reserve(roots_.size());
  for (const Root& root : roots_) {
    out.push_back({grid_indices(root.key), nodes_[root.node].count});
  }
  return out;
}

Eigen::Vector3d VoxelPlaneMap::root_centre_map(const std::array<std::int32_t, 3>& index) const {
  return T_grid_map_.inverse() * root_centre_grid(index);
}

void VoxelPlaneMap::save_root(std::size_t place, std::vector<SavedVoxel>& out) const {
  const Root& root = roots_.at(place);
  const auto index = grid_indices(root.key);
  SavedVoxel voxel;
  voxel.x = index[0];
  voxel.y = index[1];
  voxel.z = index[2];
  save_node(nodes_[root.node], voxel, out);
}

void VoxelPlaneMap::save_node(const Node& node, SavedVoxel at, std::vector<SavedVoxel>& out) const {
  put(node, at);
  out.push_back(at);
  SavedVoxel child;
  child.level = static_cast<std::uint8_t>(at.level + 1);
  for (unsigned o = 0; o < node.children.size(); ++o) {
    const std::uint32_t i = node.children[o];
    if (i == kNoChild) continue;
    child.x = 2 * at.x + static_cast<std::int32_t>(o & 1U);
    child.y = 2 * at.y + static_cast<std::int32_t>(o >> 1U & 1U);
    child.z = 2 * at.z + static_cast<std::int32_t>(o >> 2U & 1U);
    if (child.level < shift_) {
      save_node(nodes_[i], child, out);
      continue;
    }
    SavedVoxel leaf = child;
    put(leaves_[i], leaf);
    out.push_back(leaf);
  }
}

bool VoxelPlaneMap::load(const SavedVoxel& voxel) {
  if (voxel.level > shift_ || voxel.count == 0) return false;
  // Arithmetic shifts round down, for negative indices too.
  const Eigen::Vector3i root(voxel.x >> voxel.level, voxel.y >> voxel.level,
                             voxel.z >> voxel.level);
  if (root.cwiseAbs().maxCoeff() >= kMaxRoot) return false;
  const int bits = shift_ - voxel.level;
  const int mask = (1 << voxel.level) - 1;
  const Cell cell{(voxel.x & mask) << bits, (voxel.y & mask) << bits, (voxel.z & mask) << bits};
  std::uint32_t i = take_root(grid_key(root.x(), root.y(), root.z()));
  for (int level = 1; level <= voxel.level; ++level) {
    const int bit = shift_ - level;
    const unsigned o = octant(cell, bit);
    if (nodes_[i].children[o] == kNoChild) {
      // Take first: take() may reallocate the table by which nodes_[i] is found.
      const std::uint32_t taken = level == shift_ ? leaves_.take() : nodes_.take();
      nodes_[i].children[o] = taken;
    }
    i = nodes_[i].children[o];
  }
  if (voxel.level == shift_) {
    take(voxel, leaves_[i]);
    leaves_[i].refit_at = 0;
    return true;
  }
  Node& node = nodes_[i];
  take(voxel, node);
  // Fit at once: only a voxel known as a plane is settled at the next insertion.
  fit_node(node, cell, voxel.level);
  return true;
}

}  // namespace zloam::plane_map
