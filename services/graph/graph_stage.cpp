#include "graph/graph_stage.hpp"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "common/geometry/atomic_file.hpp"
#include "common/runtime/recall.hpp"
#include "graph/world_map.hpp"

namespace zloam::graph {
namespace {

// The last submap, which mapping publishes when both are stopped.
constexpr std::chrono::milliseconds kStopDrain{1000};
constexpr const char* kTrajectory = "trajectory_world.tum";
constexpr const char* kMap = "map_world.pcd";
constexpr int kTries = 2;

static_assert(static_cast<int>(Verdict::kRemoved) == static_cast<int>(msg::LoopVerdict::MAX));

}  // namespace

GraphStage::GraphStage(runtime::Stage& stage, const GraphConfig& config)
    : stage_(stage),
      config_(config),
      graph_(config),
      points_(config.output_dir),
      poses_(stage.outlet(Key::kGraphPoses)),
      loops_(stage.outlet(Key::kGraphLoop)),
      files_(config.output_dir, ".zloam-graph-runs") {
  runtime::InletOptions options;
  options.sweeps = runtime::SweepSet::kPublisherDecides;
  options.sparse = true;
  options.lossless = true;
  options.ends_run = false;
  runtime::InletOptions submaps = options;
  submaps.regular = false;
  stage.inlet<msg::Submap>(Key::kSubmap, submaps, [this](const SubmapMessage& m) { take(m); });
  stage.inlet<msg::MapPose>(Key::kMapOdometry, options, [this](const PoseMessage& m) { take(m); });
  stage.answer(stage.keys().of(Key::kPathWorld), [this](runtime::Answer& a) { answer_path(a); });
  stage.answer(stage.keys().of(Key::kGraphLoop), [this](runtime::Answer& a) { answer_loops(a); });
  // {"from_sweep": 120, "to_sweep": 870}: the loop between these two submaps; "force": true adds it
  // whatever contradicts it.
  stage.command("add", [this](const std::string& arguments) { return add(arguments); });
  stage.command("remove", [this](const std::string& arguments) { return remove(arguments); });
  stage.command("save", [this](const std::string&) { return save(); });
  stage.on_new_run([this](const msg::Header& first) { new_run(first); });
  stage.on_end_of_run([this](std::uint64_t) { write_files(); });
  stage.drain_on_stop(kStopDrain);
  stage.on_stop([this] {
    if (!unsaved_) return;
    if (const std::string error = write_files(); !error.empty()) throw runtime::IoError(error);
  });
}

void GraphStage::new_run(const msg::Header& first) {
  const bool was_in_run = !path_.empty() || !graph_.nodes().empty();
  submaps_end_ = poses_end_ = false;
  // The map continues, and so does the graph.
  if (was_in_run && runtime::goes_on(first, path_.empty() ? 0 : path_.back().instant_ns,
                                     runtime::kLongestSearch_ns)) {
    return;
  }
  if (unsaved_) stage_.lost_output(write_files());
  // Those of a map that did not begin while its run was followed.
  early_.clear();
  begin(first.map_id());
  run_ = first.run();
  replay_ = first.replay();
  if (!was_in_run) catch_up(first);
}

void GraphStage::begin(std::uint64_t map_id) {
  map_id_ = map_id;
  graph_ = LoopGraph(config_);
  points_ = SubmapPoints(config_.output_dir);
  for (const char* topic : {"points", "recall"}) stage_.degraded(topic, "");
  note_graph();
  path_.clear();
  last_.reset();
  unsaved_ = false;
  is_lost_ = true;
  starts_late_ = false;
}

CurrentMap GraphStage::current_map() const {
  CurrentMap map{map_id_, std::nullopt};
  if (!path_.empty()) map.newest_pose_ns = path_.back().instant_ns;
  map.starts_late = starts_late_ || !graph_.nodes().empty();
  return map;
}

bool GraphStage::follow_map(const PoseMessage& pose) {
  const std::uint64_t map_id = pose.header().map_id();
  const Membership of_map = membership_of_pose(current_map(), map_id, pose->instant_ns());
  if (of_map != Membership::kBegins) return of_map == Membership::kCurrent;
  // Poses of a mapping whose map had not come are of no map: the files are those of the drive.
  if (!is_lost_) {
    runtime::log_warning("mapping began a new map: so does the graph", {{"sweep", pose.sweep()}});
    if (unsaved_) stage_.lost_output(write_files());
  }
  begin(map_id);
  return true;
}

void GraphStage::take_early() {
  for (const SubmapMessage& submap : std::exchange(early_, {})) add_submap(submap);
}

// Mapping's path goes on when the driver is restarted, and then it has sweep numbers twice: poses
// are told apart by their instants.
void GraphStage::recall_path() {
  for (const auto& path :
       runtime::recall_at<msg::Path>(stage_, stage_.keys().of(Key::kPathMap), kTries, false)) {
    if (path.header().map_id() != map_id_) continue;
    for (const msg::StampedPose& p : structs_of(path->poses())) {
      if (!path_.empty() && p.instant_ns() <= path_.back().instant_ns) continue;
      path_.push_back({p.instant_ns(), p.sweep(), pose_of(p.pose())});
      is_lost_ = false;
    }
  }
}

std::vector<GraphStage::SubmapMessage> GraphStage::recall_submaps(const msg::Header& first) {
  // A store has all submaps, mapping the last ones.
  std::vector<SubmapMessage> submaps =
      runtime::recall_at<msg::Submap>(stage_, stage_.keys().all_kept_submaps(), kTries, false);
  if (first.sweep() > 0) {
    const std::string before = runtime::sweeps_from(first.run(), 0, first.sweep() - 1);
    for (SubmapMessage& submap :
         runtime::recall<msg::Submap>(stage_, Key::kSubmap, before, kTries)) {
      submaps.push_back(std::move(submap));
    }
  }
  // Submaps of the same map before the path are of another session, which was stored.
  const auto is_of_session = [&](const SubmapMessage& m) {
    const bool in_path = !path_.empty() && m->instant_ns() >= path_.front().instant_ns;
    return m.header().map_id() == map_id_ && (in_path || m.run() == first.run());
  };
  std::erase_if(submaps, [&](const SubmapMessage& m) { return !is_of_session(m); });
  std::stable_sort(submaps.begin(), submaps.end(),
                   [](const SubmapMessage& a, const SubmapMessage& b) {
                     return a->instant_ns() < b->instant_ns();
                   });
  return submaps;
}

// Sweep 0 may come late in its map: driver and graph were started again together.
bool GraphStage::has_missed(const msg::Header& first) {
  if (first.sweep() == 0 && (first.replay() || first.map_id() == first.run())) return false;
  recall_path();
  const auto goes_on = [&](const TimedPose& p) {
    return p.instant_ns < first.stamp_ns() &&
           runtime::goes_on(first, p.instant_ns, runtime::kLongestSearch_ns);
  };
  if (first.sweep() > 0 || std::ranges::any_of(path_, goes_on)) return true;
  // An earlier drive in this map has files of its own, and nothing of it is missing here.
  path_.clear();
  is_lost_ = true;
  stage_.degraded("recall", "");
  return false;
}

void GraphStage::catch_up(const msg::Header& first) {
  if (!has_missed(first)) return;
  starts_late_ = true;
  const std::vector<SubmapMessage> submaps = recall_submaps(first);
  for (const SubmapMessage& submap : submaps) add_submap(submap);
  // The last submap of an earlier run in this map does not end this run.
  submaps_end_ = std::ranges::any_of(submaps, [&](const SubmapMessage& submap) {
    return submap.end_of_run() && submap.run() == first.run();
  });
  runtime::log_info("taken up in the middle of a run",
                    {{"submaps", graph_.nodes().size()}, {"poses", path_.size()}});
}

// The first submap of a map names itself as the one before.
void GraphStage::note_recalled(const SubmapMessage& first) {
  const bool from_the_start = first->prev_frame_sweep() == first->frame_sweep();
  const bool has_path = !path_.empty() && path_.front().instant_ns <= first->instant_ns();
  if (from_the_start && has_path) return;
  const std::string text =
      std::string(has_path ? "submaps" : "poses") + " before sweep " +
      std::to_string(first.sweep()) +
      " could not be recalled: trajectory_world.tum and map_world.pcd lack a part of the drive; "
      "with zloam-store the submaps outlive a restart of the graph";
  runtime::log_warning(text);
  stage_.degraded("recall", text);
}

void GraphStage::add_submap(const SubmapMessage& message) {
  const Membership of_map =
      membership_of_submap(current_map(), message.header().map_id(), message->instant_ns());
  if (of_map == Membership::kEarly) return early_.push_back(message);
  const bool is_known =
      !graph_.nodes().empty() && message->instant_ns() <= graph_.nodes().back().instant_ns;
  if (of_map == Membership::kPast || structs_of(message->points()).size() == 0 || is_known) return;
  if (std::exchange(starts_late_, false)) note_recalled(message);
  const double begin_ms = 1e-6 * static_cast<double>(stage_.now_ns());
  const Submap submap = submap_of(*message);
  const Update update = graph_.add(submap);
  stage_.latency("submap", 1e-6 * static_cast<double>(stage_.now_ns()) - begin_ms);
  points_.add(submap.points);
  const bool missing = !config_.output_dir.empty() && !points_.complete();
  stage_.degraded("points", missing ? points_missing() : "");
  publish(message, update);
  unsaved_ = true;
  is_lost_ = false;
}

void GraphStage::take(const SubmapMessage& message) {
  add_submap(message);
  // Counted as it comes, also of a submap that waits for its map: once that begins, the run may be
  // another one, which this submap does not end.
  if (message.end_of_run()) {
    submaps_end_ = true;
    note_end(message.header());
  }
}

void GraphStage::take(const PoseMessage& message) {
  const bool is_of_map = follow_map(message);
  // Also of a pose that mapping's path had already.
  if (is_of_map) note_header(message);
  if (is_of_map && (path_.empty() || message->instant_ns() > path_.back().instant_ns)) {
    path_.push_back({message->instant_ns(), message.sweep(), pose_of(message->pose_map_base())});
    unsaved_ = true;
    is_lost_ = is_lost_ && health_of(message->health()) == Health::kLost;
  }
  take_early();
  if (message.end_of_run()) {
    poses_end_ = true;
    note_end(message.header());
  }
}

void GraphStage::note_end(const msg::Header& header) {
  if (submaps_end_ && poses_end_) stage_.end_of_run(header.run());
}

LoopFields GraphStage::fields_of(const Loop& loop) const {
  LoopFields fields;
  fields.from_sweep = graph_.nodes()[loop.from].sweep;
  fields.to_sweep = graph_.nodes()[loop.to].sweep;
  fields.T_from_to = loop.T_from_to;
  fields.covariance = loop.covariance;
  fields.overlap = loop.overlap;
  fields.residual_m = loop.residual_m;
  fields.chi2 = loop.chi2;
  fields.verdict = static_cast<msg::LoopVerdict>(loop.verdict);
  return fields;
}

void GraphStage::publish(const SubmapMessage& cause, const Update& update) {
  publish_loops(cause, update.loops);
  if (update.revised) {
    runtime::log_info("poses of the graph revised", {{"revision", graph_.revision()},
                                                     {"sweep", cause.sweep()},
                                                     {"moved_m", graph_.last_move_m()}});
  }
  note_graph();
  last_ = cause;
  publish_poses(cause);
}

void GraphStage::publish_loops(const SubmapMessage& cause, const std::vector<Loop>& loops) {
  for (const Loop& loop : loops) {
    const LoopFields fields = fields_of(loop);
    const HeaderFields header = loops_.header(cause);
    loops_.publish(header, build(header, fields));
    if (loop.verdict == Verdict::kTakenBack) {
      runtime::log_warning("a loop contradicts the others and is taken back",
                           {{"from_sweep", fields.from_sweep}, {"to_sweep", fields.to_sweep}});
    }
  }
}

void GraphStage::note_graph() {
  stage_.figure("submaps", static_cast<double>(graph_.nodes().size()));
  stage_.figure("loops", static_cast<double>(graph_.loops_in_force()));
  stage_.figure("revision", graph_.revision());
  stage_.degraded("graph", graph_.fitted()
                               ? ""
                               : "the loops in force could not be fitted: the poses are those "
                                 "of before; take the newest one out with "
                                 "command/graph/remove (loops: get graph/loop)");
}

// Answers name the run and the map of the newest message, also before its map has a submap.
void GraphStage::note_header(const runtime::Message& cause) {
  header_ = poses_.header(cause);
  header_.frame = "world";
}

void GraphStage::publish_poses(const SubmapMessage& cause) {
  std::vector<msg::SubmapPose> poses;
  for (const Node& node : graph_.nodes()) {
    poses.emplace_back(node.sweep, node.instant_ns, to_message(node.T_map_submap),
                       to_message(node.T_world_submap));
  }
  note_header(cause);
  GraphPosesFields fields;
  fields.revision = graph_.revision();
  fields.poses = poses;
  fields.loops = static_cast<std::uint32_t>(graph_.loops_in_force());
  fields.chi2_before = graph_.chi2_before();
  fields.chi2_after = graph_.chi2_after();
  poses_.publish(header_, build(header_, fields));
}

void GraphStage::answer_path(runtime::Answer& answer) {
  if (path_.empty()) return answer.refuse("no pose of this map has come yet");
  std::vector<msg::StampedPose> poses;
  for (const TimedPose& p : path_) {
    poses.emplace_back(p.instant_ns, p.sweep,
                       to_message(graph_.corrected(p.instant_ns, p.T_map_base)));
  }
  answer.reply(stage_.keys().of(Key::kPathWorld), encoding_of(Key::kPathWorld),
               build_path(header_, poses));
}

void GraphStage::answer_loops(runtime::Answer& answer) {
  // Requests by number are answered by the runtime.
  if (!answer.parameters().empty()) return;
  const std::string key = stage_.keys().of(Key::kGraphLoop);
  for (const Loop& loop : graph_.loops()) {
    answer.reply(key, encoding_of(Key::kGraphLoop), build(header_, fields_of(loop)));
  }
}

std::string GraphStage::write_trajectory(const std::string& path) const {
  Trajectory trajectory;
  for (const TimedPose& p : path_) {
    trajectory.push_back({p.instant_ns, graph_.corrected(p.instant_ns, p.T_map_base)});
  }
  TrajectoryText text(trajectory, tum_line);
  return write_file_atomically(path, [&] { return text.next(); });
}

std::string GraphStage::points_missing() const {
  return config_.output_dir + "/" + kMap + " can't be written: " + config_.output_dir +
         " did not take the points of the submaps; make room there and run again";
}

std::string GraphStage::write_points(const std::string& path) const {
  if (!points_.complete()) return points_missing();
  std::size_t submap = 0;
  bool unread = false;
  std::string error = write_world_map(path, points_.count(), [&]() -> std::optional<PlacedPoints> {
    if (submap == points_.submaps()) return std::nullopt;
    PlacedPoints part{points_.of(submap), graph_.nodes()[submap].T_world_submap};
    unread |= part.points.empty();
    ++submap;
    return part;
  });
  if (!unread) return error;
  return path + " can't be written: points of submaps could not be read back from a file in " +
         config_.output_dir;
}

/// Each map of a run has files of its own, and so has each run in a map that is resumed.
runtime::OutputFiles::Run GraphStage::file_run() const {
  constexpr std::uint64_t kSpread = 0x9E3779B97F4A7C15;
  const std::size_t count = std::max(path_.size(), graph_.nodes().size());
  return {run_ ^ (map_id_ * kSpread), replay_, count};
}

std::string GraphStage::write_files() {
  if (config_.output_dir.empty()) return {};
  const runtime::OutputFiles::Run run = file_run();
  const std::string suffix = files_.suffix(run, {kTrajectory, kMap});
  const std::string trajectory = files_.path(kTrajectory, suffix), map = files_.path(kMap, suffix);
  std::string error = write_trajectory(trajectory);
  if (error.empty()) error = files_.made(trajectory, run);
  if (error.empty()) error = write_points(map);
  if (error.empty()) error = files_.made(map, run);
  stage_.degraded("files", error);
  if (!error.empty()) {
    runtime::log_error("files not written", {{"reason", error}});
    return error;
  }
  unsaved_ = false;
  runtime::log_info("trajectory and map with loops closed written", {{"trajectory", trajectory},
                                                                     {"poses", path_.size()},
                                                                     {"map", map},
                                                                     {"points", points_.count()}});
  return {};
}

}  // namespace zloam::graph
