#pragma once
// Wires the graph of loops to the runtime: takes submaps and poses; publishes loops, revisions,
// answers and files. It is outside the chain: no pose ever waits for it.

#include <optional>
#include <string>
#include <vector>

#include "common/geometry/trajectory.hpp"
#include "common/runtime/output_files.hpp"
#include "common/runtime/stage.hpp"
#include "graph/loop_graph.hpp"
#include "graph/submap_points.hpp"

namespace zloam::graph {

class GraphStage {
 public:
  GraphStage(runtime::Stage& stage, const GraphConfig& config);

 private:
  using SubmapMessage = runtime::Received<msg::Submap>;
  using PoseMessage = runtime::Received<msg::MapPose>;
  struct TimedPose {
    std::int64_t instant_ns;
    std::uint64_t sweep;
    Pose T_map_base;
  };

  void new_run(const msg::Header& first);
  /// Starts an empty graph for a new map.
  void begin();
  /// Requests the run's submaps from mapping, for a graph that was started in the middle of it.
  void catch_up(const msg::Header& first);
  void take(const SubmapMessage& message);
  void take(const PoseMessage& message);
  void note_end(const msg::Header& header);
  void publish(const SubmapMessage& cause, const Update& update);
  void note_fit();
  void publish_poses(const SubmapMessage& cause);
  void answer_path(runtime::Answer& answer);
  /// All loops that were ever candidates, with their present verdicts.
  void answer_loops(runtime::Answer& answer);
  LoopFields fields_of(const Loop& loop) const;
  runtime::CommandReply remove(const std::string& arguments_json);
  runtime::CommandReply save();
  /// Empty, or a sentence that says what failed.
  std::string write_files();
  std::string write_trajectory(const std::string& path) const;
  std::string points_missing() const;
  std::string write_points(const std::string& path) const;

  runtime::Stage& stage_;
  GraphConfig config_;
  LoopGraph graph_;
  /// of the graph's nodes
  SubmapPoints points_;
  runtime::Outlet& poses_;
  runtime::Outlet& loops_;
  runtime::OutputFiles files_;
  std::vector<TimedPose> path_;
  HeaderFields header_;
  std::optional<SubmapMessage> last_;
  std::optional<std::uint64_t> map_id_;
  bool submaps_end_ = false, poses_end_ = false;
  bool unsaved_ = false;
  runtime::OutputFiles::Run run_;
};

}  // namespace zloam::graph
