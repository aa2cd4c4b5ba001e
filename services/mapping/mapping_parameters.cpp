#include "mapping/mapping_parameters.hpp"

#include <algorithm>
#include <array>
#include <string>

#include "common/runtime/parameters.hpp"

namespace zloam::mapping {
namespace {

using runtime::Effect;
using runtime::Parameters;

/// The centre tile is one of them: an even number would mean the next odd one.
std::string error_of(const std::array<int, 3>& tiles) {
  const bool odd = std::all_of(tiles.begin(), tiles.end(), [](int n) { return n % 2 == 1; });
  return odd ? "" : "must be odd numbers, as the tile of the sensor is in the middle";
}

void bind_map(Parameters& p, MappingConfig& c) {
  p.add("mapping.mode", &c.mode,
        {{"map", MappingMode::kMap},
         {"localize", MappingMode::kLocalize},
         {"extend", MappingMode::kExtend}},
        "map: begin a new map; localize: find the robot in the tile store's map without changing "
        "it; extend: find the robot in that map and continue mapping");
  p.add("mapping.every", &c.every, {1, 1000}, "",
        "map every n-th sweep by number, and the last one; slices are all mapped");
  p.add("mapping.tile_edge_m", &c.tile_edge_m, {2.0, 1000.0}, "m", "edge of a tile of the map");
  p.add("mapping.window_tiles", &c.window_tiles, {1, 1001}, "",
        "tiles kept in memory around the sensor: x, y, z, odd numbers");
  p.add("mapping.local_tiles", &c.local_tiles, {1, 1001}, "",
        "tiles around the sensor that map/surround shows: x, y, z, odd numbers");
  p.check("mapping.window_tiles", [&c] { return error_of(c.window_tiles); });
  p.check("mapping.local_tiles",
          [&c]() -> std::string {
            if (std::string error = error_of(c.local_tiles); !error.empty()) return error;
            for (std::size_t a = 0; a < 3; ++a) {
              if (c.local_tiles[a] > c.window_tiles[a])
                return "must not exceed mapping.window_tiles";
            }
            return {};
          },
          {"mapping.window_tiles"});
}

void bind_points(Parameters& p, MappingConfig& c) {
  p.add("mapping.leaf_edge_m", &c.leaf_edge_m, {0.02, 5.0}, "m",
        "voxel size of the map's edge points");
  p.add("mapping.leaf_plane_m", &c.leaf_plane_m, {0.02, 5.0}, "m",
        "voxel size of the map's plane points");
  p.add("mapping.archive_points", &c.archive_points, {0, 1e12}, "",
        "points of tiles outside the window that are kept in memory; further points go to a file",
        Effect::kNone);
  p.add("mapping.spill_directory", &c.spill_directory,
        "folder of the file for points outside the window; empty: all points stay in memory",
        Effect::kNone);
}

void bind_insertion(Parameters& p, MappingConfig& c) {
  p.add("mapping.insert_distance_m", &c.insert_distance_m, {0.0, 100.0}, "m",
        "insert a sweep after this motion since the last inserted one; 0: the rotation alone "
        "decides; both 0: insert every sweep")
      .live();
  p.add("mapping.insert_rotation_rad", &c.insert_rotation_rad, {0.0, 3.15}, "rad",
        "insert a sweep also after this rotation since the last inserted one; 0: the motion alone "
        "decides")
      .live();
  p.add("mapping.drift_limit", &c.drift_limit, {1e-6, 1.0}, "",
        "health is Degenerate if the points leave a direction with a sigma above this share of 10 "
        "m, or of 1 rad")
      .live();
}

void bind_bridging(Parameters& p, MappingConfig& c) {
  p.add("mapping.bridge_distance_m", &c.bridge_distance_m, {0.0, 50.0}, "m",
        "search radius around the last pose for a new odometry frame")
      .live();
  p.add("mapping.bridge_rotation_rad", &c.bridge_rotation_rad, {0.0, 3.15}, "rad",
        "search range of the rotation around the last pose for a new odometry frame")
      .live();
  p.add("mapping.bridge_sweeps", &c.bridge_sweeps, {1, 1e6}, "sweeps",
        "sweeps without an accepted match after which the health is Lost")
      .live();
}

void bind_voxel_planes(Parameters& p, VoxelPlanesConfig& c) {
  p.add("mapping.voxel_planes.root_voxel_m", &c.map.root_voxel_m, {0.1, 50.0}, "m",
        "edge of the coarsest voxels; each level halves it");
  p.add("mapping.voxel_planes.levels", &c.map.levels, {2, 6}, "", "number of voxel sizes");
  p.add("mapping.voxel_planes.keep_radius_m", &c.map.keep_radius_m, {10.0, 4000.0}, "m",
        "voxels farther from the sensor are dropped");
  plane_map::MatcherConfig& m = c.matcher;
  p.add("mapping.voxel_planes.stride", &m.stride, {1, 100}, "", "match every n-th point of a sweep")
      .live();
  p.add("mapping.voxel_planes.correlation", &m.correlation, {1.0, 1e4}, "",
        "divisor of the information, because residuals on one surface are correlated")
      .live();
  p.add("mapping.voxel_planes.tile_stride", &c.tile_stride, {1, 1000}, "",
        "put every n-th point of a sweep into the tiles")
      .live();
}

void bind_output(Parameters& p, OutputConfig& output) {
  p.add("mapping.map_path", &output.map_path,
        "PCD file of the map, written at the end of a run; empty: no file", Effect::kNone);
  p.add("mapping.publish_every", &output.publish_every, {1, 10000}, "",
        "publish changed tiles, surround and registered sweeps every n-th mapped sweep",
        Effect::kNone)
      .live();
  p.add("mapping.publish_growth", &output.publish_growth, {0.0, 10.0}, "",
        "publish a tile when its points have grown by this share", Effect::kNone)
      .live();
  p.add("mapping.cloud_every", &output.cloud_every, {1, 100000}, "",
        "publish the whole map every n-th mapped sweep while there is a subscriber", Effect::kNone)
      .live();
  p.add("mapping.voxels_every", &output.voxels_every, {1, 100000}, "",
        "publish voxel counts for the tile store every n-th mapped sweep", Effect::kNone)
      .live();
  p.add("mapping.voxels_growth", &output.voxels_growth, {0.0, 10.0}, "",
        "publish a cube of voxels when its points have grown by this share; after a restart at "
        "most this share is missing",
        Effect::kNone)
      .live();
  p.add("mapping.take_back_s", &output.take_back_s, {0.0, 1e9}, "s",
        "live start: resume the stored map if its last pose is at most this old", Effect::kNone);
  p.add("mapping.store_link_s", &output.store_link_s, {0.0, 60.0}, "s",
        "after start, wait up to this long for the tile store before creating a new map; 0: no "
        "store deployed",
        Effect::kNone);
}

}  // namespace

void bind(Parameters& parameters, MappingConfig& config, OutputConfig& output) {
  bind_map(parameters, config);
  bind_points(parameters, config);
  bind_insertion(parameters, config);
  bind_bridging(parameters, config);
  bind_voxel_planes(parameters, config.voxel_planes);
  bind_output(parameters, output);
}

}  // namespace zloam::mapping
