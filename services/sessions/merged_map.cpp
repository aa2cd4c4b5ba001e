#include "sessions/merged_map.hpp"

#include <algorithm>
#include <optional>
#include <set>

namespace zloam::sessions {
namespace {

// Finer than the leaves of any robot file; a stage with larger ones joins these.
constexpr double kLeaf_m = 0.1;
// More points of a voxel would tell no more of its plane.
constexpr std::uint32_t kMostDrawn = 1000;

// A plane drops its finer voxels as early as those far behind the sensor do, since the whole map
// lies behind it.
plane_map::PlaneMapConfig voxel_config(const MapSizes& sizes) {
  plane_map::PlaneMapConfig config;
  config.root_voxel_m = sizes.root_voxel_m;
  config.levels = sizes.levels;
  config.range_noise_m = sizes.range_noise_m;
  config.settled_points = config.settled_far_points;
  return config;
}

bool fits(const mapping::LayerMap& layer, std::size_t most_in_cube) {
  return layer.left_out() == 0 &&
         std::ranges::all_of(layer.tiles(), [&](const mapping::TileIndex& index) {
           return layer.tile_points(index).size() <= most_in_cube;
         });
}

}  // namespace

MapBuilder::MapBuilder(const MapSizes& sizes)
    : tile_edge_m_(sizes.tile_edge_m),
      layers_{mapping::LayerMap(kLeaf_m, sizes.tile_edge_m),
              mapping::LayerMap(kLeaf_m, sizes.tile_edge_m)},
      voxels_(voxel_config(sizes)) {}

void MapBuilder::add_points(std::span<const MapPart> parts, std::size_t most_in_cube) {
  for (const Layer which : kLayers) {
    mapping::LayerMap& layer = layers_[static_cast<std::size_t>(which)];
    for (double leaf_m = kLeaf_m;; leaf_m *= 2.0) {
      layer = mapping::LayerMap(leaf_m, tile_edge_m_);
      for (const MapPart& part : parts) add_points(part, which, layer);
      if (fits(layer, most_in_cube)) break;
    }
  }
}

void MapBuilder::add_points(const MapPart& part, Layer which, mapping::LayerMap& layer) {
  for (const mapping::Tile& tile : part.tiles) {
    if (tile.id.layer != which) continue;
    for (std::size_t i = 0; i < tile.points.size(); ++i) {
      const MapPoint& p = tile.points[i];
      const Eigen::Vector3d at(p.x, p.y, p.z);
      const auto submap = part.places.standing_at(at);
      if (!submap) continue;
      const std::uint32_t count = i < tile.counts.size() ? std::max(tile.counts[i], 1U) : 1U;
      layer.insert(part.T_world_map[*submap] * at, p.intensity, count);
    }
  }
}

void MapBuilder::add_voxels(const MapPart& part, Half half) {
  // All maps have the same grid.
  const Pose T_map_grid = voxels_.T_grid_map().inverse();
  for (const mapping::VoxelTile& cube : part.voxels) {
    const std::vector<Patch> patches = patches_of(cube.voxels, cube.root_voxel_m);
    local_.clear();
    bool is_first = true;
    for (const Patch& patch : patches) {
      const auto submap = part.places.standing_at(T_map_grid * patch.mean);
      if (!submap) continue;
      const Pose T_grid_grid = voxels_.T_grid_map() * part.T_world_map[*submap] * T_map_grid;
      if (is_first) voxels_.set_anchor(T_grid_grid * patch.mean);
      is_first = false;
      draw(patch, T_grid_grid, half);
    }
    // Fits what the first half has counted, because only a voxel known as a plane drops its finer
    // ones.
    hints_.resize(local_.size());
    if (half == Half::kSecond) voxels_.find_all(local_, hints_);
    voxels_.insert(local_);
  }
}

// The points of the majority's ring are spread evenly among the others, whose rings are unknown.
void MapBuilder::draw(const Patch& patch, const Pose& T_grid_grid, Half half) {
  const std::uint32_t count = std::min(patch.count, kMostDrawn);
  const std::uint64_t lead = std::uint64_t{patch.lead} * count / patch.count;
  const std::vector<Eigen::Vector3d>& cloud = clouds_.of(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    if ((i % 2 == 0) != (half == Half::kFirst)) continue;
    const Eigen::Vector3f at =
        (T_grid_grid * (patch.mean + patch.spread * cloud[i]) - voxels_.anchor_grid())
            .cast<float>();
    const bool is_lead = (i + 1) * lead / count > i * lead / count;
    local_.push_back({at.x(), at.y(), at.z(), is_lead ? patch.ring : plane_map::kUnknownRing});
  }
}

std::vector<mapping::Tile> MapBuilder::tiles() const {
  std::set<mapping::TileId> ids;
  for (const Layer which : kLayers) {
    const mapping::LayerMap& layer = layers_[static_cast<std::size_t>(which)];
    for (const mapping::TileIndex& index : layer.tiles()) ids.insert({index, which});
  }
  std::vector<mapping::Tile> out;
  for (const mapping::TileId& id : ids) {
    mapping::Tile tile{id, tile_edge_m_, 1, {}, {}};
    const mapping::LayerMap& layer = layers_[static_cast<std::size_t>(id.layer)];
    for (const mapping::CountedPoint& p : layer.tile_points(id.index)) {
      const Eigen::Vector3f at = p.mean.cast<float>();
      tile.points.push_back({at.x(), at.y(), at.z(), p.intensity});
      tile.counts.push_back(p.count);
    }
    out.push_back(std::move(tile));
  }
  return out;
}

std::vector<mapping::VoxelTile> MapBuilder::voxels() const {
  constexpr double kAll = -1.0;
  return mapping::VoxelTiles().take_changed(voxels_, kAll);
}

}  // namespace zloam::sessions
