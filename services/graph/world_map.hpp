#pragma once
// The points of submaps as one map, each submap at its pose by the graph.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::graph {

/// Points of a submap, in its frame, and the pose of that frame.
struct PlacedPoints {
  std::vector<MapPoint> points;
  Pose T_world_submap = Pose::Identity();
};

/// Writes a map file (common/geometry/map_file.hpp). count: all points; next: one submap after
/// another, each with points; nothing at the end. Empty, or a sentence that says what failed.
std::string write_world_map(const std::string& path, std::size_t count,
                            const std::function<std::optional<PlacedPoints>()>& next);

}  // namespace zloam::graph
