#include "mapping/io/tile_messages.hpp"

#include <string>
#include <utility>

#include "common/messages/convert.hpp"

namespace zloam::mapping {
namespace {

msg::MapVoxel to_message(const plane_map::SavedVoxel& v) {
  return {v.x,
          v.y,
          v.z,
          v.count,
          v.level,
          v.lead < v.count,
          v.ring,
          flatbuffers::span<const float, 3>(v.sum),
          flatbuffers::span<const float, 6>(v.squares)};
}

plane_map::SavedVoxel voxel_of(const msg::MapVoxel& m) {
  plane_map::SavedVoxel v;
  v.x = m.x();
  v.y = m.y();
  v.z = m.z();
  v.count = m.count();
  v.level = m.level();
  // A message without leads only tells whether the points are of several rings or all of one.
  v.lead = m.several_rings() ? 0 : m.count();
  v.ring = m.ring();
  for (std::size_t i = 0; i < v.sum.size(); ++i) {
    v.sum[i] = m.sum()->Get(static_cast<flatbuffers::uoffset_t>(i));
  }
  for (std::size_t i = 0; i < v.squares.size(); ++i) {
    v.squares[i] = m.squares()->Get(static_cast<flatbuffers::uoffset_t>(i));
  }
  return v;
}

VoxelTile voxel_tile_of(const msg::MapTile& m) {
  VoxelTile tile{{m.i(), m.j(), m.k()}, m.edge_m(), m.version(), m.root_voxel_m(), m.levels(),
                 m.range_noise_m(),     {}};
  for (const msg::MapVoxel& v : structs_of(m.voxels())) tile.voxels.push_back(voxel_of(v));
  if (m.leads() != nullptr) {
    for (std::size_t i = 0; i < tile.voxels.size(); ++i) {
      tile.voxels[i].lead = m.leads()->Get(static_cast<flatbuffers::uoffset_t>(i));
    }
  }
  return tile;
}

}  // namespace

Buffer tile_message(const HeaderFields& header, const Tile& tile) {
  MapTileFields fields;
  fields.layer = layer_name(tile.id.layer);
  fields.i = tile.id.index.i;
  fields.j = tile.id.index.j;
  fields.k = tile.id.index.k;
  fields.edge_m = tile.edge_m;
  fields.version = tile.version;
  fields.points = tile.points;
  fields.counts = tile.counts;
  return build(header, fields);
}

Buffer voxel_message(const HeaderFields& header, const VoxelTile& tile) {
  std::vector<msg::MapVoxel> voxels;
  std::vector<std::uint32_t> leads;
  for (const plane_map::SavedVoxel& v : tile.voxels) {
    voxels.push_back(to_message(v));
    leads.push_back(v.lead);
  }
  MapTileFields fields;
  fields.layer = kVoxelLayer;
  fields.i = tile.index.i;
  fields.j = tile.index.j;
  fields.k = tile.index.k;
  fields.edge_m = tile.edge_m;
  fields.version = tile.version;
  fields.voxels = voxels;
  fields.leads = leads;
  fields.root_voxel_m = tile.root_voxel_m;
  fields.levels = static_cast<std::uint8_t>(tile.levels);
  fields.range_noise_m = tile.range_noise_m;
  return build(header, fields);
}

void add_tile(const msg::MapTile& m, SavedMap& saved) {
  const std::string name = m.layer()->str();
  if (name == kVoxelLayer) {
    saved.voxels.push_back(voxel_tile_of(m));
    return;
  }
  const auto layer = layer_from_name(name);
  if (!layer) return;
  Tile tile{{{m.i(), m.j(), m.k()}, *layer}, m.edge_m(), m.version(), {}, {}};
  const std::span<const MapPoint> points = map_points_of(m.points());
  tile.points.assign(points.begin(), points.end());
  if (m.counts() != nullptr) tile.counts.assign(m.counts()->begin(), m.counts()->end());
  saved.tiles.push_back(std::move(tile));
}

}  // namespace zloam::mapping
