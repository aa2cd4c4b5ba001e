#pragma once
// Cubes of the map as messages, and back: mapping publishes them, the tile store keeps them, and
// services/sessions writes those of merged maps.

#include "common/messages/build.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Layer of the voxels' counts in keys and messages; the others are in map_layer.hpp.
inline constexpr const char* kVoxelLayer = "voxels";

Buffer tile_message(const HeaderFields& header, const Tile& tile);
Buffer voxel_message(const HeaderFields& header, const VoxelTile& tile);

/// Adds a cube of any layer to the map; a layer of another name is left out. The message must have
/// been verified.
void add_tile(const msg::MapTile& message, SavedMap& saved);

}  // namespace zloam::mapping
