#include "mapping/voxel_tiles.hpp"

#include "mapping/grid_index.hpp"

namespace zloam::mapping {
namespace {

struct Roots {
  std::uint64_t points = 0;
  /// indices into VoxelPlaneMap::roots()
  std::vector<std::size_t> places;
};

// Keeps the roots of a cube in order of creation, so that a saved and loaded map is identical.
std::map<TileIndex, Roots> roots_by_cube(const plane_map::VoxelPlaneMap& map, double edge_m) {
  std::map<TileIndex, Roots> cubes;
  const std::vector<plane_map::RootSummary> roots = map.roots();
  for (std::size_t i = 0; i < roots.size(); ++i) {
    Roots& cube = cubes[tile_index(map.root_centre_map(roots[i].index), edge_m)];
    cube.points += roots[i].count;
    cube.places.push_back(i);
  }
  return cubes;
}

}  // namespace

bool VoxelTiles::fits(const VoxelTile& tile, const plane_map::PlaneMapConfig& config) {
  return tile.edge_m == kEdge_m && tile.root_voxel_m == config.root_voxel_m &&
         tile.levels == config.levels;
}

std::vector<VoxelTile> VoxelTiles::take_changed(const plane_map::VoxelPlaneMap& map,
                                                double growth) {
  std::vector<VoxelTile> changed;
  for (const auto& [index, roots] : roots_by_cube(map, kEdge_m)) {
    Cube& cube = cubes_[index];
    // With fewer points it was dropped far from the sensor and begun again: the version handed out
    // before stays the better one until these are more.
    const auto handed_out = static_cast<double>(cube.points);
    if (static_cast<double>(roots.points) <= (1.0 + growth) * handed_out) continue;
    cube.points = roots.points;
    const plane_map::PlaneMapConfig& config = map.config();
    VoxelTile tile{
        index, kEdge_m, ++cube.version, config.root_voxel_m, config.levels, config.range_noise_m,
        {}};
    for (const std::size_t place : roots.places) map.save_root(place, tile.voxels);
    changed.push_back(std::move(tile));
  }
  return changed;
}

void VoxelTiles::load_into(plane_map::VoxelPlaneMap& map) {
  for (const VoxelTile& tile : kept_) {
    Cube& cube = cubes_[tile.index];
    cube.version = tile.version;
    if (!fits(tile, map.config())) continue;
    for (const plane_map::SavedVoxel& voxel : tile.voxels) {
      if (map.load(voxel) && voxel.level == 0) cube.points += voxel.count;
    }
  }
  kept_.clear();
  kept_.shrink_to_fit();
}

}  // namespace zloam::mapping
