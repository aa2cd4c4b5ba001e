#include "common/plane_map/voxel_plane_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "common/geometry/grid_key.hpp"

namespace zloam::plane_map {
namespace {

std::uint64_t hash(std::uint64_t x) {
  x ^= x >> 31;
  x *= 0x9E3779B97F4A7C15ull;
  return x ^ (x >> 29);
}

void check(const PlaneMapConfig& c) {
  const bool ok = c.root_voxel_m > 0.0 && c.levels >= 2 && c.levels <= 6 && c.range_noise_m > 0.0 &&
                  c.min_points >= 3 && c.refit_growth >= 1.0 && c.keep_radius_m > c.root_voxel_m;
  if (!ok) {
    throw std::invalid_argument("plane map: configuration out of range");
  }
}

}  // namespace

VoxelPlaneMap::VoxelPlaneMap(const PlaneMapConfig& config)
    : config_(config), own_gates_(own_gates(config)), merged_gates_(merged_gates(config)) {
  check(config);
  T_grid_map_ = Pose::Identity();
  T_grid_map_.linear() = exp_so3(config.grid_rotation_rad);
  T_grid_map_.translation() = config.grid_shift_m;
  shift_ = config.levels - 1;
  leaf_m_ = config.root_voxel_m / (1 << shift_);
  leaf_per_m_ = static_cast<float>(1.0 / leaf_m_);
  rebuild_table(1024);
}

void VoxelPlaneMap::set_anchor(const Eigen::Vector3d& position_grid) {
  anchor_ = (position_grid / config_.root_voxel_m).array().round().cast<int>();
}

Eigen::Vector3d VoxelPlaneMap::anchor_grid() const {
  return anchor_.cast<double>() * config_.root_voxel_m;
}

std::uint64_t VoxelPlaneMap::root_key(const Cell& c) const {
  return grid_key((c.x >> shift_) + anchor_.x(), (c.y >> shift_) + anchor_.y(),
                  (c.z >> shift_) + anchor_.z());
}

std::uint32_t VoxelPlaneMap::find_root(std::uint64_t key) const {
  const std::size_t mask = table_.size() - 1;
  for (std::size_t i = hash(key) & mask; table_[i] != 0; i = (i + 1) & mask) {
    const Root& root = roots_[table_[i] - 1];
    if (root.key == key) {
      return root.node;
    }
  }
  return kNoChild;
}

std::uint32_t VoxelPlaneMap::take_root(std::uint64_t key) {
  const std::uint32_t found = find_root(key);
  if (found != kNoChild) {
    return found;
  }
  roots_.push_back({key, nodes_.take()});
  if (2 * roots_.size() > table_.size()) {
    rebuild_table(2 * table_.size());
  } else {
    const std::size_t mask = table_.size() - 1;
    std::size_t i = hash(key) & mask;
    while (table_[i] != 0) {
      i = (i + 1) & mask;
    }
    table_[i] = static_cast<std::uint32_t>(roots_.size());
  }
  return roots_.back().node;
}

void VoxelPlaneMap::rebuild_table(std::size_t slots) {
  table_.assign(slots, 0);
  const std::size_t mask = slots - 1;
  for (std::size_t r = 0; r < roots_.size(); ++r) {
    std::size_t i = hash(roots_[r].key) & mask;
    while (table_[i] != 0) {
      i = (i + 1) & mask;
    }
    table_[i] = static_cast<std::uint32_t>(r + 1);
  }
}

std::array<float, 3> VoxelPlaneMap::root_centre(const Cell& c) const {
  const auto centre = [&](int cell) {
    return (static_cast<float>(cell >> shift_) + 0.5f) * static_cast<float>(config_.root_voxel_m);
  };
  return {centre(c.x), centre(c.y), centre(c.z)};
}

void VoxelPlaneMap::release_children(Node& node, int level) {
  for (std::uint32_t& child : node.children) {
    if (child == kNoChild) {
      continue;
    }
    if (level + 1 == shift_) {
      set_kind(leaves_[child], Kind::kNone);
      leaves_.release(child);
    } else {
      release_node(child, level + 1);
    }
    child = kNoChild;
  }
}

void VoxelPlaneMap::release_node(std::uint32_t node, int level) {
  release_children(nodes_[node], level);
  set_kind(nodes_[node], Kind::kNone);
  nodes_.release(node);
}

void VoxelPlaneMap::settle(Node& node, int level) {
  release_children(node, level);
  node.kind = Kind::kSettledPlane;
}

void VoxelPlaneMap::settle_far_planes(Node& node, int level) {
  if (node.kind == Kind::kPlane && node.count >= config_.settled_far_points) {
    settle(node, level);
  }
  if (node.kind == Kind::kSettledPlane || level + 1 == shift_) {
    return;
  }
  for (const std::uint32_t child : node.children) {
    if (child != kNoChild) {
      settle_far_planes(nodes_[child], level + 1);
    }
  }
}

Eigen::Vector3d VoxelPlaneMap::root_centre_grid(const std::array<std::int32_t, 3>& index) const {
  const Eigen::Vector3d cell(index[0], index[1], index[2]);
  return (cell.array() + 0.5).matrix() * config_.root_voxel_m;
}

void VoxelPlaneMap::leave_behind(const Eigen::Vector3d& position_grid) {
  if (left_behind_from_grid_) {
    const Eigen::Vector3d& from = *left_behind_from_grid_;
    if ((position_grid - from).norm() < config_.keep_radius_m / 20.0) {
      return;
    }
    settle_behind(from, position_grid);
  }
  drop_far(position_grid);
  left_behind_from_grid_ = position_grid;
}

// Settles the planes of each root once, when the sensor leaves it: settled planes stay settled.
void VoxelPlaneMap::settle_behind(const Eigen::Vector3d& from_grid,
                                  const Eigen::Vector3d& to_grid) {
  for (const Root& root : roots_) {
    const Eigen::Vector3d centre = root_centre_grid(grid_indices(root.key));
    if ((centre - from_grid).norm() <= config_.settled_radius_m &&
        (centre - to_grid).norm() > config_.settled_radius_m) {
      settle_far_planes(nodes_[root.node], 0);
    }
  }
}

void VoxelPlaneMap::drop_far(const Eigen::Vector3d& position_grid) {
  const auto keep_end = std::remove_if(roots_.begin(), roots_.end(), [&](const Root& root) {
    const Eigen::Vector3d centre = root_centre_grid(grid_indices(root.key));
    if ((centre - position_grid).norm() <= config_.keep_radius_m) {
      return false;
    }
    release_node(root.node, 0);
    return true;
  });
  if (keep_end != roots_.end()) {
    roots_.erase(keep_end, roots_.end());
    rebuild_table(table_.size());
  }
}

std::optional<MapPlane> VoxelPlaneMap::plane_at(const Eigen::Vector3d& point_map) {
  const Eigen::Vector3d grid = T_grid_map_ * point_map;
  set_anchor(grid);
  const Eigen::Vector3f local = (grid - anchor_grid()).cast<float>();
  const Match match = find(local.x(), local.y(), local.z());
  if (!match.is_plane) {
    return std::nullopt;
  }
  const PlaneRow& row = *match.rows;
  const Eigen::Vector3d normal(row.nx, row.ny, row.nz);
  const Eigen::Vector3d root(match.root_centre[0], match.root_centre[1], match.root_centre[2]);
  const Eigen::Vector3d foot =
      local.cast<double>() - normal * (normal.dot(local.cast<double>() - root) - row.d);
  const Pose T_map_grid = T_grid_map_.inverse();
  return MapPlane{T_map_grid.linear() * normal, T_map_grid * (foot + anchor_grid())};
}

MapStatistics VoxelPlaneMap::statistics() const {
  return {roots_.size(), nodes_.in_use() + leaves_.in_use(),
          nodes_.bytes() + leaves_.bytes() + planes_.bytes() + rows_.bytes() +
              roots_.capacity() * sizeof(Root) + table_.capacity() * sizeof(std::uint32_t)};
}

}  // namespace zloam::plane_map
