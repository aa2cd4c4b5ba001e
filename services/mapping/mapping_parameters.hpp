#pragma once
// Names of mapping's parameters in the robot's file.

#include "mapping/config.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::mapping {

/// What only the program needs; nothing here changes a pose or the map.
struct OutputConfig {
  /// the map at the end of a run and of the process; empty: no file
  std::string map_path = "out/map.pcd";
  /// tiles, surround and registered sweeps leave every n-th mapped sweep, the whole map every
  /// cloud_every-th; only while someone listens
  std::uint32_t publish_every = 5;
  /// a tile leaves when it has grown by more than this share since it left last, and at the end of
  /// a run: the store writes all that leaves
  double publish_growth = 0.05;
  std::uint32_t cloud_every = 50;
  /// what was counted in voxels, for the store: more bytes than the tiles. As many sweeps may be
  /// missing after a restart, and this share of what was counted in a place.
  std::uint32_t voxels_every = 20;
  double voxels_growth = 0.25;
  /// live: the store's map is taken back when the sensor was away for less; an older one may be of
  /// another place
  double take_back_s = 60.0;
  /// so long after its start a mapping waits at the first sweep for the store to be there before it
  /// founds a map; 0: no store is part of the deployment
  double store_link_s = 0.0;
};

void bind(runtime::Parameters& parameters, MappingConfig& config, OutputConfig& output);

}  // namespace zloam::mapping
