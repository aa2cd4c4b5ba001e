#include "mapping/layer_map.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::mapping {
namespace {

// A point farther away is no place on earth, and its indices might not fit into a number.
constexpr double kFarthest_m = 1e9;
constexpr std::size_t kFetchAhead = 8;
// A voxel with so many points takes no more: its mean is known to micrometres. A robot that stands
// for days gives a voxel more points than its count can hold; and the sum of the intensities, in
// single precision, would lose what is added long before.
constexpr std::uint32_t kMostCounted = 1U << 22;
// An arbitrary rotation that aligns no axis of the grid with one of the map's, and a shift that is
// no simple fraction of a voxel.
const Eigen::Vector3d kGridTurn_rad(0.1, 0.15, 0.5);
const Eigen::Vector3d kGridShift_m(0.137, 0.291, 0.173);

bool is_place(const Eigen::Vector3d& point_map) {
  return point_map.allFinite() && point_map.cwiseAbs().maxCoeff() <= kFarthest_m;
}

}  // namespace

LayerMap::LayerMap(double leaf_m, double tile_edge_m)
    : leaf_m_(leaf_m), tile_edge_m_(tile_edge_m), R_grid_map_(exp_so3(kGridTurn_rad)) {}

TileIndex LayerMap::tile_of(const Eigen::Vector3d& point_map) const {
  return tile_index(point_map, tile_edge_m_);
}

Eigen::Vector3d LayerMap::centre_map(const GridIndex& index) const {
  return R_grid_map_.transpose() * (centre_of(index, leaf_m_) - kGridShift_m);
}

std::uint64_t LayerMap::key_of(const Eigen::Vector3d& point_map) const {
  if (!is_place(point_map)) return kNoKey;
  const GridIndex index = grid_index(R_grid_map_ * point_map + kGridShift_m, leaf_m_);
  return has_key(index) ? pack_key(index) : kNoKey;
}

void LayerMap::insert(const Eigen::Vector3d& point_map, float intensity, std::uint32_t count) {
  if (count > 0) insert_at(key_of(point_map), {point_map, intensity}, count);
}

// A sweep's voxels are scattered in memory: the index entry is prefetched well before a voxel is
// needed, the voxel itself shortly before.
void LayerMap::fetch_ahead(std::size_t at) const {
  if (at + 2 * kFetchAhead < new_keys_.size()) {
    voxel_index_.prefetch(new_keys_[at + 2 * kFetchAhead]);
  }
  if (at + kFetchAhead < new_keys_.size()) {
    const std::uint32_t id = voxel_index_.find(new_keys_[at + kFetchAhead]);
    if (id != FlatIndex::kNone) __builtin_prefetch(&voxels_[id], 1);
  }
}

void LayerMap::insert(std::span<const NewPoint> points_map) {
  new_keys_.clear();
  for (const NewPoint& point : points_map) new_keys_.push_back(key_of(point.position));
  for (std::size_t i = 0; i < points_map.size(); ++i) {
    fetch_ahead(i);
    insert_at(new_keys_[i], points_map[i], 1);
  }
}

void LayerMap::insert_at(std::uint64_t key, const NewPoint& point_map, std::uint32_t count) {
  if (key == kNoKey) {
    if (is_place(point_map.position)) ++left_out_;
    return;
  }
  const Eigen::Vector3d centre = centre_map(unpack_key(key));
  const std::uint32_t id = voxel_at(key);
  Voxel& voxel = voxels_[id];
  // Of a voxel that another process counted, more may come at once.
  count = std::min(count, kMostCounted - voxel.count);
  if (count == 0) return;
  voxel.sum += static_cast<double>(count) * (point_map.position - centre);
  const float intensity = point_map.intensity;
  if (std::isfinite(intensity)) voxel.intensity_sum += static_cast<float>(count) * intensity;
  const Eigen::Vector3d mean = centre + voxel.sum / static_cast<double>(voxel.count + count);
  TileRecord* at = voxel.tile;
  if (at == nullptr || !lies_well_within(mean, at->index, at->index, tile_edge_m_)) {
    const TileIndex tile = tile_of(mean);
    if (at == nullptr || at->index != tile) move_to_tile(id, tile);
  }
  voxel.count += count;
  voxel.tile->count += count;
  touch(*voxel.tile);
}

std::uint32_t LayerMap::voxel_at(std::uint64_t key) {
  const std::uint32_t found = voxel_index_.find(key);
  if (found != FlatIndex::kNone) return found;
  const std::uint32_t id = voxels_.take();
  voxels_[id].key = key;
  voxel_index_.insert(key, id);
  return id;
}

LayerMap::TileRecord& LayerMap::record(const TileIndex& index) {
  TileRecord& tile = tiles_[index];
  tile.index = index;
  return tile;
}

void LayerMap::touch(TileRecord& tile) {
  if (tile.changed) return;
  tile.changed = true;
  changed_.push_back(tile.index);
}

void LayerMap::move_to_tile(std::uint32_t id, const TileIndex& index) {
  Voxel& voxel = voxels_[id];
  if (voxel.tile != nullptr) {
    std::erase(voxel.tile->voxels, id);
    voxel.tile->count -= voxel.count;
    touch(*voxel.tile);
  }
  voxel.tile = &record(index);
  voxel.tile->voxels.push_back(id);
  voxel.tile->count += voxel.count;
}

std::vector<TileIndex> LayerMap::take_changed() {
  std::vector<TileIndex> changed;
  changed.swap(changed_);
  for (const TileIndex& index : changed) {
    TileRecord& tile = tiles_.at(index);
    tile.changed = false;
    ++tile.version;
  }
  std::sort(changed.begin(), changed.end());
  return changed;
}

std::vector<CountedPoint> LayerMap::tile_points(const TileIndex& index) const {
  std::vector<CountedPoint> points;
  const auto found = tiles_.find(index);
  if (found == tiles_.end()) return points;
  points.reserve(found->second.voxels.size());
  for (const std::uint32_t id : found->second.voxels) {
    const Voxel& voxel = voxels_[id];
    const Eigen::Vector3d mean = centre_map(unpack_key(voxel.key)) + voxel.sum / voxel.count;
    points.push_back({mean, voxel.count, voxel.intensity_sum / static_cast<float>(voxel.count)});
  }
  return points;
}

void LayerMap::drop_voxel(std::uint32_t id) {
  voxel_index_.erase(voxels_[id].key);
  voxels_.release(id);
}

std::vector<CountedPoint> LayerMap::remove_tile(const TileIndex& index) {
  std::vector<CountedPoint> points = tile_points(index);
  const auto found = tiles_.find(index);
  if (found == tiles_.end()) return points;
  for (const std::uint32_t id : found->second.voxels) drop_voxel(id);
  if (found->second.changed) std::erase(changed_, index);
  tiles_.erase(found);
  return points;
}

void LayerMap::restore_tile(const TileIndex& index, std::uint64_t version,
                            std::span<const CountedPoint> points) {
  const std::vector<TileIndex> before = changed_;
  for (const CountedPoint& point : points) insert(point.mean, point.intensity, point.count);
  for (const TileIndex& changed : changed_) {
    if (std::find(before.begin(), before.end(), changed) == before.end()) {
      tiles_.at(changed).changed = false;
    }
  }
  changed_ = before;
  record(index).version = std::max(record(index).version, version);
}

std::uint64_t LayerMap::tile_version(const TileIndex& index) const {
  const auto found = tiles_.find(index);
  return found == tiles_.end() ? 0 : found->second.version;
}

std::uint64_t LayerMap::tile_count(const TileIndex& index) const {
  const auto found = tiles_.find(index);
  return found == tiles_.end() ? 0 : found->second.count;
}

std::vector<TileIndex> LayerMap::tiles() const {
  std::vector<TileIndex> indices;
  for (const auto& [index, tile] : tiles_) {
    if (!tile.voxels.empty()) indices.push_back(index);
  }
  return indices;
}

}  // namespace zloam::mapping
