#pragma once
// The plane map by cubes, for the store and back. A coarsest voxel belongs to the cube that its
// centre lies in.

#include <map>
#include <vector>

#include "common/plane_map/voxel_plane_map.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

class VoxelTiles {
 public:
  /// Small, so that what grows is handed out and not all that lies around it.
  static constexpr double kEdge_m = 12.5;

  /// The cubes in which more than this share of what was handed out has been counted since, whole,
  /// ascending.
  std::vector<VoxelTile> take_changed(const plane_map::VoxelPlaneMap& map, double growth);

  void keep_for_loading(const std::vector<VoxelTile>& tiles) { kept_ = tiles; }
  /// Loads what was kept into a map that is still empty. Cubes of other voxel sizes or of another
  /// noise are left out: their counts mean something else.
  void load_into(plane_map::VoxelPlaneMap& map);

 private:
  struct Cube {
    std::uint64_t version = 0;
    /// points counted in it when it was handed out last
    std::uint64_t points = 0;
  };
  std::map<TileIndex, Cube> cubes_;
  std::vector<VoxelTile> kept_;
};

}  // namespace zloam::mapping
