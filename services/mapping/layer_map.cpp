#include "mapping/layer_map.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::mapping {
namespace {

constexpr double kFarthest_m = 1e5;
// Any turn that brings no axis of the grid near one of the map's, and a shift that is no simple
// fraction of a voxel.
const Eigen::Vector3d kGridTurn_rad(0.1, 0.15, 0.5);
const Eigen::Vector3d kGridShift_m(0.137, 0.291, 0.173);

struct Step {
  int i, j, k;
};

// A cell and its 26 neighbours, the nearest kinds first, so that the search is cut early.
std::array<Step, 27> search_order() {
  std::array<Step, 27> order{};
  std::size_t n = 0;
  for (int away = 0; away <= 3; ++away) {
    for (int i = -1; i <= 1; ++i) {
      for (int j = -1; j <= 1; ++j) {
        for (int k = -1; k <= 1; ++k) {
          if (i * i + j * j + k * k == away) order[n++] = {i, j, k};
        }
      }
    }
  }
  return order;
}
const std::array<Step, 27> kOrder = search_order();

Eigen::Matrix<std::int64_t, 3, 1> grid_index(const Eigen::Vector3d& p, double edge_m) {
  return (p / edge_m).array().floor().cast<std::int64_t>().matrix();
}

// Distance on one axis from a point, `inside` the cell from its lower side, to the neighbour's box.
double axis_gap(int step, double inside, double edge_m, double margin_m) {
  if (step == 0) return 0.0;
  return std::max(0.0, (step < 0 ? inside : edge_m - inside) - margin_m);
}

}  // namespace

LayerMap::LayerMap(double leaf_m, double tile_edge_m, double radius_m)
    : leaf_m_(leaf_m),
      tile_edge_m_(tile_edge_m),
      margin_m_(leaf_m * 0.5 * std::sqrt(3.0)),
      cell_edge_m_(radius_m + margin_m_),
      R_grid_map_(exp_so3(kGridTurn_rad)) {}

TileIndex LayerMap::tile_of(const Eigen::Vector3d& point_map) const {
  const auto index = grid_index(point_map, tile_edge_m_);
  return {static_cast<std::int32_t>(index.x()), static_cast<std::int32_t>(index.y()),
          static_cast<std::int32_t>(index.z())};
}

void LayerMap::insert(const Eigen::Vector3d& point_map, float intensity, const RingRange& rings,
                      std::uint32_t count) {
  if (!point_map.allFinite() || point_map.cwiseAbs().maxCoeff() > kFarthest_m || count == 0) return;
  const std::uint32_t id = voxel_at(point_map, rings);
  Voxel& voxel = voxels_[id];
  voxel.sum += static_cast<double>(count) * (point_map - voxel.anchor);
  voxel.count += count;
  if (std::isfinite(intensity)) voxel.intensity_sum += static_cast<float>(count) * intensity;
  const Eigen::Vector3d mean = voxel.mean();
  Cell& cell = cells_[voxel.cell];
  CellEntry& entry = cell.entries[voxel.place_in_cell];
  entry.offset = (mean - cell.centre).cast<float>();
  entry.rings.join(rings);
  const TileIndex tile = tile_of(mean);
  if (voxel.tile == nullptr || voxel.tile->index != tile) move_to_tile(id, tile);
  touch(*voxels_[id].tile);
}

std::uint32_t LayerMap::voxel_at(const Eigen::Vector3d& point_map, const RingRange& rings) {
  const Eigen::Vector3d in_grid = R_grid_map_ * point_map + kGridShift_m;
  const auto index = grid_index(in_grid, leaf_m_);
  const std::uint64_t key = pack_key(index.x(), index.y(), index.z());
  const std::uint32_t found = voxel_index_.find(key);
  if (found != FlatIndex::kNone) return found;
  const Eigen::Vector3d centre_grid =
      (index.cast<double>() + Eigen::Vector3d::Constant(0.5)) * leaf_m_;
  return found_voxel(key, R_grid_map_.transpose() * (centre_grid - kGridShift_m), point_map, rings);
}

std::uint32_t LayerMap::found_voxel(std::uint64_t key, const Eigen::Vector3d& centre_map,
                                    const Eigen::Vector3d& point_map, const RingRange& rings) {
  std::uint32_t id = static_cast<std::uint32_t>(voxels_.size());
  if (free_voxels_.empty()) {
    voxels_.emplace_back();
  } else {
    id = free_voxels_.back();
    free_voxels_.pop_back();
    voxels_[id] = Voxel{};
  }
  Voxel& voxel = voxels_[id];
  voxel.key = key;
  voxel.anchor = point_map;
  voxel.cell = cell_at(centre_map);
  Cell& cell = cells_[voxel.cell];
  voxel.place_in_cell = static_cast<std::uint32_t>(cell.entries.size());
  cell.entries.push_back({(point_map - cell.centre).cast<float>(), id, rings});
  voxel_index_.insert(key, id);
  ++live_;
  return id;
}

std::uint32_t LayerMap::cell_at(const Eigen::Vector3d& centre_map) {
  const auto index = grid_index(centre_map, cell_edge_m_);
  const std::uint64_t key = pack_key(index.x(), index.y(), index.z());
  std::uint32_t slot = cell_index_.find(key);
  if (slot != FlatIndex::kNone) return slot;
  if (free_cells_.empty()) {
    slot = static_cast<std::uint32_t>(cells_.size());
    cells_.emplace_back();
  } else {
    slot = free_cells_.back();
    free_cells_.pop_back();
  }
  cells_[slot].key = key;
  cells_[slot].centre = (index.cast<double>() + Eigen::Vector3d::Constant(0.5)) * cell_edge_m_;
  cell_index_.insert(key, slot);
  return slot;
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
    touch(*voxel.tile);
  }
  voxel.tile = &record(index);
  voxel.tile->voxels.push_back(id);
}

std::size_t LayerMap::nearest(const Eigen::Vector3d& point_map, double radius_m,
                              std::span<Neighbour> out) const {
  if (!point_map.allFinite() || out.empty() || point_map.cwiseAbs().maxCoeff() > kFarthest_m) {
    return 0;
  }
  const auto index = grid_index(point_map, cell_edge_m_);
  const Eigen::Vector3d inside = point_map - index.cast<double>() * cell_edge_m_;
  const double limit = radius_m * radius_m;
  double worst = limit;
  std::size_t found = 0;
  for (const Step& step : kOrder) {
    const Eigen::Vector3d gap(axis_gap(step.i, inside.x(), cell_edge_m_, margin_m_),
                              axis_gap(step.j, inside.y(), cell_edge_m_, margin_m_),
                              axis_gap(step.k, inside.z(), cell_edge_m_, margin_m_));
    if (gap.squaredNorm() > worst) continue;
    const std::uint32_t slot =
        cell_index_.find(pack_key(index.x() + step.i, index.y() + step.j, index.z() + step.k));
    if (slot == FlatIndex::kNone) continue;
    const Cell& cell = cells_[slot];
    const Eigen::Vector3f query = (point_map - cell.centre).cast<float>();
    for (const CellEntry& entry : cell.entries) {
      const double squared = static_cast<double>((entry.offset - query).squaredNorm());
      if (squared >= worst) continue;
      std::size_t at = found < out.size() ? found++ : found - 1;
      for (; at > 0 && out[at - 1].squared_m2 > squared; --at) out[at] = out[at - 1];
      out[at] = {cell.centre + entry.offset.cast<double>(), squared, entry.rings};
      if (found == out.size()) worst = out[found - 1].squared_m2;
    }
  }
  return found;
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
    points.push_back(
        {voxel.mean(), voxel.count, voxel.intensity_sum / static_cast<float>(voxel.count)});
  }
  return points;
}

void LayerMap::drop_voxel(std::uint32_t id) {
  Voxel& voxel = voxels_[id];
  Cell& cell = cells_[voxel.cell];
  // The last entry takes the free place.
  cell.entries[voxel.place_in_cell] = cell.entries.back();
  voxels_[cell.entries[voxel.place_in_cell].voxel].place_in_cell = voxel.place_in_cell;
  cell.entries.pop_back();
  if (cell.entries.empty()) {
    cell_index_.erase(cell.key);
    cell.entries.shrink_to_fit();
    free_cells_.push_back(voxel.cell);
  }
  voxel_index_.erase(voxel.key);
  free_voxels_.push_back(id);
  --live_;
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
  for (const CountedPoint& point : points) insert(point.mean, point.intensity, {}, point.count);
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

std::vector<TileIndex> LayerMap::tiles() const {
  std::vector<TileIndex> indices;
  for (const auto& [index, tile] : tiles_) {
    if (!tile.voxels.empty()) indices.push_back(index);
  }
  return indices;
}

}  // namespace zloam::mapping
