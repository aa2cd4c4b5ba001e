#include "common/plane_map/voxel_plane_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "common/geometry/grid_key.hpp"

namespace zloam::plane_map {
namespace {

constexpr float kMaxLocal_m = 4096.0f;

inline int floor_to_int(float x) {
  const int i = static_cast<int>(x);
  return i - static_cast<int>(static_cast<float>(i) > x);
}

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

inline std::optional<VoxelPlaneMap::Cell> VoxelPlaneMap::cell_of(float x, float y, float z) const {
  // Written so that NaN fails too.
  if (!(std::abs(x) < kMaxLocal_m && std::abs(y) < kMaxLocal_m && std::abs(z) < kMaxLocal_m)) {
    return std::nullopt;
  }
  return Cell{floor_to_int(x * leaf_per_m_), floor_to_int(y * leaf_per_m_),
              floor_to_int(z * leaf_per_m_)};
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

inline std::array<float, 3> VoxelPlaneMap::root_centre(const Cell& c) const {
  const auto centre = [&](int cell) {
    return (static_cast<float>(cell >> shift_) + 0.5f) * static_cast<float>(config_.root_voxel_m);
  };
  return {centre(c.x), centre(c.y), centre(c.z)};
}

inline void VoxelPlaneMap::Counted::add_ring(std::uint16_t of_point) {
  if (count == 0) {
    ring = of_point;
  }
  several_rings = several_rings || of_point == kUnknownRing || of_point != ring;
}

inline Match VoxelPlaneMap::match_of(const Counted& voxel, const Cell& cell) const {
  if (voxel.kind == Kind::kNone) {
    return {};
  }
  if (voxel.is_plane()) {
    const Plane& plane = planes_[voxel.fit];
    return {&plane.row, 1, true, plane.normal_variance, root_centre(cell)};
  }
  const int count = voxel.kind == Kind::kLine ? 2 : 3;
  return {rows_[voxel.fit].data(), count, false, 0.0f, root_centre(cell)};
}

Match VoxelPlaneMap::find(float x, float y, float z) {
  const auto cell = cell_of(x, y, z);
  return cell ? look_up(*cell) : Match();
}

const Match& VoxelPlaneMap::find(float x, float y, float z, Hint& hint) {
  const auto cell = cell_of(x, y, z);
  if (!cell || cell != hint.cell) {
    hint = {cell, cell ? look_up(*cell) : Match()};
  }
  return hint.match;
}

Match VoxelPlaneMap::look_up(const Cell& cell) {
  std::uint32_t i = find_root(root_key(cell));
  for (int bit = shift_ - 1; bit >= 0 && i != kNoChild; --bit) {
    Node& node = nodes_[i];
    if (node.count >= node.refit_at) {
      fit_node(node, cell, shift_ - 1 - bit);
    }
    if (node.is_plane()) {
      return match_of(node, cell);
    }
    i = node.children[octant(cell, bit)];
  }
  if (i == kNoChild) {
    return {};
  }
  Leaf& leaf = leaves_[i];
  if (leaf.count >= leaf.refit_at) {
    fit_leaf(leaf, cell);
  }
  return match_of(leaf, cell);
}

void VoxelPlaneMap::insert(float x, float y, float z, std::uint16_t ring) {
  const auto cell = cell_of(x, y, z);
  if (!cell) {
    return;
  }
  const std::array<float, 3> root = root_centre(*cell);
  // Offset from the voxel's centre, kept while the voxel halves.
  float dx = x - root[0];
  float dy = y - root[1];
  float dz = z - root[2];
  float quarter = 0.25f * static_cast<float>(config_.root_voxel_m);
  std::uint32_t i = take_root(root_key(*cell));
  for (int bit = shift_ - 1; bit >= 0; --bit) {
    Node& node = nodes_[i];
    node.sums.add(dx, dy, dz);
    node.add_ring(ring);
    ++node.count;
    if (node.kind == Kind::kPlane && node.count >= config_.settled_points) {
      settle(node, shift_ - 1 - bit);
    }
    if (node.kind == Kind::kSettledPlane) {
      return;
    }
    const unsigned o = octant(*cell, bit);
    if (node.children[o] == kNoChild) {
      node.children[o] = bit == 0 ? leaves_.take() : nodes_.take();
    }
    i = node.children[o];
    dx += (o & 1) != 0 ? -quarter : quarter;
    dy += (o & 2) != 0 ? -quarter : quarter;
    dz += (o & 4) != 0 ? -quarter : quarter;
    quarter *= 0.5f;
  }
  Leaf& leaf = leaves_[i];
  leaf.add_ring(ring);
  leaf.sums.add(dx, dy, dz);
  ++leaf.count;
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
      release_children(nodes_[child], level + 1);
      set_kind(nodes_[child], Kind::kNone);
      nodes_.release(child);
    }
    child = kNoChild;
  }
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

Eigen::Vector3d VoxelPlaneMap::root_centre_grid(std::uint64_t key) const {
  const auto [i, j, k] = grid_indices(key);
  const Eigen::Vector3d cell(i, j, k);
  return (cell.array() + 0.5).matrix() * config_.root_voxel_m;
}

void VoxelPlaneMap::leave_behind(const Eigen::Vector3d& position_grid) {
  if (left_once_ && (position_grid - left_behind_from_).norm() < config_.keep_radius_m / 20.0) {
    return;
  }
  const auto is_gone = [&](const Root& root) {
    const Eigen::Vector3d centre = root_centre_grid(root.key);
    const double distance_m = (centre - position_grid).norm();
    // Once, as the sensor leaves: a settled plane stays one.
    if (left_once_ && distance_m > config_.settled_radius_m &&
        (centre - left_behind_from_).norm() <= config_.settled_radius_m) {
      settle_far_planes(nodes_[root.node], 0);
    }
    if (distance_m <= config_.keep_radius_m) {
      return false;
    }
    release_children(nodes_[root.node], 0);
    set_kind(nodes_[root.node], Kind::kNone);
    nodes_.release(root.node);
    return true;
  };
  const auto keep_end = std::remove_if(roots_.begin(), roots_.end(), is_gone);
  if (keep_end != roots_.end()) {
    roots_.erase(keep_end, roots_.end());
    rebuild_table(table_.size());
  }
  left_once_ = true;
  left_behind_from_ = position_grid;
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

void VoxelPlaneMap::insert_points(std::span<const Eigen::Vector3d> points_map) {
  for (const Eigen::Vector3d& point : points_map) {
    const Eigen::Vector3d grid = T_grid_map_ * point;
    if (!grid.allFinite()) {
      continue;
    }
    set_anchor(grid);
    const Eigen::Vector3f local = (grid - anchor_grid()).cast<float>();
    insert(local.x(), local.y(), local.z());
  }
}

MapStatistics VoxelPlaneMap::statistics() const {
  return {roots_.size(), nodes_.in_use() + leaves_.in_use(),
          nodes_.bytes() + leaves_.bytes() + planes_.bytes() + rows_.bytes() +
              roots_.capacity() * sizeof(Root) + table_.capacity() * sizeof(std::uint32_t)};
}

}  // namespace zloam::plane_map
