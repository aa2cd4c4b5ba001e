#include "mapping/tile_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace zloam::mapping {
namespace {

std::vector<MapPoint> map_points(const std::vector<CountedPoint>& counted) {
  std::vector<MapPoint> points;
  points.reserve(counted.size());
  for (const CountedPoint& p : counted) {
    points.push_back({static_cast<float>(p.mean.x()), static_cast<float>(p.mean.y()),
                      static_cast<float>(p.mean.z()), p.intensity});
  }
  return points;
}

Tile tile_of(const TileId& id, double edge_m, std::uint64_t version,
             const std::vector<CountedPoint>& counted) {
  Tile tile{id, edge_m, version, map_points(counted), {}};
  tile.counts.reserve(counted.size());
  for (const CountedPoint& p : counted) tile.counts.push_back(p.count);
  return tile;
}

}  // namespace

TileMap::TileMap(const MappingConfig& config)
    : tile_edge_m_(config.tile_edge_m),
      window_(config.window_tiles),
      local_(config.local_tiles),
      layers_{LayerMap(config.leaf_edge_m, config.tile_edge_m),
              LayerMap(config.leaf_plane_m, config.tile_edge_m)},
      archive_(config.archive_points, config.spill_directory) {}

bool TileMap::within(const TileIndex& index, const std::array<int, 3>& extent) const {
  return std::abs(index.i - centre_.i) <= extent[0] / 2 &&
         std::abs(index.j - centre_.j) <= extent[1] / 2 &&
         std::abs(index.k - centre_.k) <= extent[2] / 2;
}

std::vector<Tile> TileMap::follow(const Eigen::Vector3d& sensor_map) {
  std::vector<Tile> evicted;
  const TileIndex centre = layers_[0].tile_of(sensor_map);
  if (centre == centre_) return evicted;
  centre_ = centre;
  for (const Layer which : kLayers) {
    for (const TileIndex& index : layer(which).tiles()) {
      if (within(index, window_)) continue;
      const TileId id{index, which};
      const std::uint64_t version = layer(which).tile_version(index);
      std::vector<CountedPoint> points = layer(which).remove_tile(index);
      evicted.push_back(tile_of(id, tile_edge_m_, version, points));
      if (auto earlier = archive_.take(id)) {
        points.insert(points.begin(), earlier->points.begin(), earlier->points.end());
      }
      archive_.put(id, {version, std::move(points)});
    }
  }
  for (const TileId& id : archive_.tiles()) {
    if (!within(id.index, window_)) continue;
    const auto entry = archive_.take(id);
    if (!entry) continue;
    layer(id.layer).restore_tile(id.index, entry->version, entry->points);
  }
  std::sort(evicted.begin(), evicted.end(),
            [](const Tile& a, const Tile& b) { return a.id < b.id; });
  return evicted;
}

void TileMap::insert(Layer which, PointSpan points_base, const Pose& T_map_base) {
  LayerMap& target = layer(which);
  const auto corner = [this](int sign) {
    return TileIndex{centre_.i + sign * (window_[0] / 2), centre_.j + sign * (window_[1] / 2),
                     centre_.k + sign * (window_[2] / 2)};
  };
  const TileIndex first = corner(-1), last = corner(1);
  const auto is_in_window = [&](const Eigen::Vector3d& point_map) {
    return lies_well_within(point_map, first, last, tile_edge_m_) ||
           (point_map.allFinite() && within(target.tile_of(point_map), window_));
  };
  new_points_.clear();
  for (const Point& p : points_base) {
    const Eigen::Vector3d point_map = T_map_base * p.position().cast<double>();
    if (!is_in_window(point_map)) continue;
    new_points_.push_back({point_map, p.intensity});
  }
  target.insert(new_points_);
}

void TileMap::restore(const Tile& tile) {
  std::vector<CountedPoint> points;
  points.reserve(tile.points.size());
  for (std::size_t i = 0; i < tile.points.size(); ++i) {
    const MapPoint& p = tile.points[i];
    const std::uint32_t count = i < tile.counts.size() ? std::max(tile.counts[i], 1U) : 1U;
    points.push_back({Eigen::Vector3d(p.x, p.y, p.z), count, p.intensity});
  }
  if (within(tile.id.index, window_)) {
    layer(tile.id.layer).restore_tile(tile.id.index, tile.version, points);
  } else {
    archive_.put(tile.id, {tile.version, std::move(points)});
  }
}

std::vector<TileId> TileMap::take_changed() {
  std::vector<TileId> changed;
  for (const Layer which : kLayers) {
    for (const TileIndex& index : layer(which).take_changed()) changed.push_back({index, which});
  }
  std::sort(changed.begin(), changed.end());
  return changed;
}

std::optional<Tile> TileMap::tile(const TileId& id) const {
  std::vector<CountedPoint> points = layer(id.layer).tile_points(id.index);
  if (!points.empty()) {
    return tile_of(id, tile_edge_m_, layer(id.layer).tile_version(id.index), points);
  }
  const auto archived = archive_.get(id);
  if (!archived) return std::nullopt;
  return tile_of(id, tile_edge_m_, archived->version, archived->points);
}

std::vector<TileId> TileMap::tiles() const {
  std::vector<TileId> ids = archive_.tiles();
  for (const Layer which : kLayers) {
    for (const TileIndex& index : layer(which).tiles()) ids.push_back({index, which});
  }
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  return ids;
}

std::vector<TileId> TileMap::local_tiles() const {
  std::vector<TileId> ids = tiles();
  std::erase_if(ids, [this](const TileId& id) { return !within(id.index, local_); });
  return ids;
}

std::size_t TileMap::point_count() const {
  return layers_[0].point_count() + layers_[1].point_count() + archive_.point_count();
}

}  // namespace zloam::mapping
