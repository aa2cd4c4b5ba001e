// Restores an odometry that was killed and restarted: mapping keeps its last odometry/features,
// registration its inputs since then.

#include <algorithm>

#include "aloam/core/clouds.hpp"
#include "aloam/odometry/odometry_stage.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::aloam {
namespace {

constexpr int kReplayTries = 5;
constexpr std::chrono::milliseconds kLinks{500};

PointVector in_lidar(PointSpan points, const Pose& T_lidar_base) {
  PointVector out;
  out.reserve(points.size());
  for (const Point& p : points) out.push_back(moved(p, T_lidar_base));
  return out;
}

/// Whether the frame of these commits continues in a run that begins with this sweep.
bool continues(const msg::Header& first,
               const std::vector<runtime::Received<msg::OdometryFeatures>>& commits) {
  if (commits.empty() || commits.back().run() != first.run()) return false;
  return first.replay() || runtime::goes_on(first, commits.back()->instant_ns());
}

}  // namespace

void OdometryStage::restart(const msg::Header& first) {
  const auto linked = [this] { return pose_.matching() && features_.matching(); };
  if (first.sweep() > 0) runtime::wait_for_links(linked, kLinks);
  const auto commits = runtime::recall<msg::OdometryFeatures>(
      stage_, Key::kOdometryFeatures, runtime::kKept, first.replay() ? kReplayTries : 1);
  if (continues(first, commits)) {
    restore(commits);
    catch_up(first.run(), commits.back().sweep() + 1);
    return;
  }
  // In a replay the epoch is a function of the capture.
  if (first.replay()) return;
  const auto used = runtime::used_odom_epoch(stage_, commits);
  if (!used) return;
  odom_epoch_ = *used + 1;
  runtime::log_warning("a new odom frame begins: the one before could not be continued",
                       {{"odom_epoch", odom_epoch_}, {"sweep", first.sweep()}});
}

void OdometryStage::restore(const std::vector<Commit>& commits) {
  const Commit& last = commits.back();
  const Pose T_lidar_base = T_base_lidar_.inverse();
  const Pose T_odom_base = pose_of(last->pose_odom_base());
  ScanMotion motion;
  motion.instant_ns = last->instant_ns();
  motion.T_odom_lidar = T_lidar_base * T_odom_base * T_base_lidar_;
  // If the last step is unknown, the search for the first one starts from rest.
  if (commits.size() > 1 && commits[commits.size() - 2].sweep() == last->prev_sweep()) {
    const Commit& before = commits[commits.size() - 2];
    const Pose step = pose_of(before->pose_odom_base()).inverse() * T_odom_base;
    motion.step = T_lidar_base * step * T_base_lidar_;
    motion.periods = periods_between(before->instant_ns(), motion.instant_ns, last->period_ns());
  }
  motion.edges = in_lidar(points_of(last->edges()), T_lidar_base);
  motion.planes = in_lidar(points_of(last->planes()), T_lidar_base);
  odometry_.restore(motion);
  odom_epoch_ = last.header().odom_epoch();
  prev_sweep_ = last.sweep();
  next_sweep_ = last.sweep() + 1;
  last_instant_ns_ = last->instant_ns();
  last_header_ = header_fields(last.header());
  runtime::log_warning("resuming the odometry of the previous instance", {{"sweep", next_sweep_}});
}

void OdometryStage::catch_up(std::uint64_t run, std::uint64_t from) {
  for (const Features& features :
       runtime::recall<msg::Features>(stage_, Key::kFeatures, runtime::sweeps_from(run, from), 1)) {
    if (features.sweep() >= next_sweep_) process(features);
  }
}

}  // namespace zloam::aloam
