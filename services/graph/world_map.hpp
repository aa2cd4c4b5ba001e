#pragma once
// The points of submaps as one map, each submap where the graph has it.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::graph {

/// Points of a submap, in its frame, and where that lies.
struct PlacedPoints {
  std::vector<MapPoint> points;
  Pose T_world_submap = Pose::Identity();
};

/// Writes a map file (common/geometry/map_file.hpp). count: all points; next: submap after submap,
/// none of them without points, none after the last one. Empty, or a sentence on what failed.
std::string write_world_map(const std::string& path, std::size_t count,
                            const std::function<std::optional<PlacedPoints>()>& next);

}  // namespace zloam::graph
