#pragma once
// Files written from saved maps after joining them to one graph: poses (TUM), the graph (g2o), the
// map (PCD) and a report (JSON).

#include <filesystem>
#include <string>
#include <vector>

#include "graph/loop_graph.hpp"
#include "sessions/saved_map.hpp"

namespace zloam::sessions {

/// The graph of several maps: session i is maps[i].
struct Merged {
  std::vector<SavedMap> maps;
  graph::LoopGraph graph;

  /// Whether the session lies in the frame of the first one.
  bool is_joined(std::size_t session) const { return graph.frame_of(session) == 0; }
  struct Placed {
    /// maps[session].submaps[index]
    std::size_t session = 0, index = 0;
    Pose T_world_submap = Pose::Identity();
  };
  /// Submaps of the joined maps, map by map, in the frame of the first one.
  std::vector<Placed> placed() const;
};

/// Each function returns an empty string, or a sentence that says what failed.
/// Submaps' poses in the frame of the first map: submaps_1.tum and so on.
std::string write_submap_poses(const Merged& merged, const std::filesystem::path& folder);
/// VERTEX_SE3:QUAT and EDGE_SE3:QUAT as g2o, GTSAM and Ceres' examples read them.
std::string write_g2o(const Merged& merged, const std::filesystem::path& path);
/// All points of the maps that are joined.
std::string write_points(const Merged& merged, const std::filesystem::path& path);
std::string write_report(const Merged& merged, const std::filesystem::path& path);

}  // namespace zloam::sessions
