#pragma once
// The plane map divided into cubes, to and from the store. A coarsest voxel belongs to the cube
// that contains its centre.

#include <map>
#include <vector>

#include "common/plane_map/voxel_plane_map.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

class VoxelTiles {
 public:
  /// Small, so that little besides the voxels that grow is published.
  static constexpr double kEdge_m = 12.5;

  /// The cubes whose counts have grown by more than this share since they were returned last,
  /// whole, ascending.
  std::vector<VoxelTile> take_changed(const plane_map::VoxelPlaneMap& map, double growth);

  /// Whether the cube can be loaded into a map of this configuration. Its range noise may be
  /// another: the counts do not depend on it, only the planes that are fitted to them.
  static bool fits(const VoxelTile& tile, const plane_map::PlaneMapConfig& config);

  void keep_for_loading(const std::vector<VoxelTile>& tiles) { kept_ = tiles; }
  /// Loads the kept tiles into a map that is still empty. Cubes that do not fit are ignored: their
  /// counts mean something else.
  void load_into(plane_map::VoxelPlaneMap& map);

 private:
  struct Cube {
    std::uint64_t version = 0;
    /// points counted in it when it was returned last
    std::uint64_t points = 0;
  };
  std::map<TileIndex, Cube> cubes_;
  std::vector<VoxelTile> kept_;
};

}  // namespace zloam::mapping
