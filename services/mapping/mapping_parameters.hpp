#pragma once
// Names of mapping's parameters in the robot's file.

#include "mapping/config.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::mapping {

/// Settings of the program only; none changes a pose or the map.
struct OutputConfig {
  std::string map_path = "out/map.pcd";
  std::uint32_t publish_every = 5;
  double publish_growth = 0.05;
  std::uint32_t cloud_every = 50;
  std::uint32_t voxels_every = 20;
  double voxels_growth = 0.25;
  double take_back_s = 60.0;
  double store_link_s = 0.0;
};

void bind(runtime::Parameters& parameters, MappingConfig& config, OutputConfig& output);

}  // namespace zloam::mapping
