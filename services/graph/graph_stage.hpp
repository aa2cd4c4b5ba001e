#pragma once
// Wires the graph of loops to the runtime: takes submaps and poses; publishes loops, revisions,
// answers and files. It is outside the chain: no pose ever waits for it.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/geometry/trajectory.hpp"
#include "common/runtime/output_files.hpp"
#include "common/runtime/stage.hpp"
#include "graph/loop_graph.hpp"
#include "graph/map_membership.hpp"
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
  /// Starts an empty graph for a map.
  void begin(std::uint64_t map_id);
  CurrentMap current_map() const;
  /// Begins a new graph when mapping has begun a new map. False: the pose is a late one of the map
  /// before.
  bool follow_map(const PoseMessage& pose);
  /// Adds the submaps whose map has begun meanwhile.
  void take_early();
  /// Requests poses and submaps of the map so far, for a graph that was started in the middle of a
  /// run.
  void catch_up(const msg::Header& first);
  /// Recalls the path; false: this is the first message of the drive.
  bool has_missed(const msg::Header& first);
  void recall_path();
  std::vector<SubmapMessage> recall_submaps(const msg::Header& first);
  /// first: the first submap of a graph that starts in the middle of a drive, recalled or new.
  void note_recalled(const SubmapMessage& first);
  /// Adds a submap of the current map to the graph; one of a map that has not begun waits.
  void add_submap(const SubmapMessage& message);
  void take(const SubmapMessage& message);
  void take(const PoseMessage& message);
  void note_end(const msg::Header& header);
  void publish(const SubmapMessage& cause, const Update& update);
  void publish_loops(const SubmapMessage& cause, const std::vector<Loop>& loops);
  /// In the status: what the graph has, and whether its loops could be fitted.
  void note_graph();
  void note_header(const runtime::Message& cause);
  void publish_poses(const SubmapMessage& cause);
  void answer_path(runtime::Answer& answer);
  /// All loops that were ever candidates, with their present verdicts.
  void answer_loops(runtime::Answer& answer);
  LoopFields fields_of(const Loop& loop) const;
  runtime::CommandReply add(const std::string& arguments_json);
  runtime::CommandReply remove(const std::string& arguments_json);
  runtime::CommandReply with_loops(std::string message) const;
  runtime::CommandReply save();
  /// Empty, or a sentence that says what failed.
  std::string write_files();
  runtime::OutputFiles::Run file_run() const;
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
  /// submaps of a map of which no pose was handled yet
  std::vector<SubmapMessage> early_;
  HeaderFields header_;
  std::optional<SubmapMessage> last_;
  std::uint64_t map_id_ = 0;
  bool submaps_end_ = false, poses_end_ = false;
  bool unsaved_ = false;
  /// all poses of this map so far
  bool is_lost_ = true;
  /// started in the middle of a drive, of which no submap has come yet
  bool starts_late_ = false;
  std::uint64_t run_ = 0;
  bool replay_ = false;
};

}  // namespace zloam::graph
