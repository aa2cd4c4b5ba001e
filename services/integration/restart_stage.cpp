// Restart of integration after a kill: the trajectory so far is in the journal, and the poses since
// then are computed from what odometry and mapping still have (docs/protocol.md, section 7).

#include <algorithm>

#include "common/runtime/recall.hpp"
#include "integration/integration_stage.hpp"

namespace zloam::integration {
namespace {

constexpr int kTries = 5;

}  // namespace

void IntegrationStage::restart(const msg::Header& first) {
  if (const std::string unread = journal_.keep_unread(); !unread.empty()) {
    runtime::log_warning(
        "the poses of an earlier run can't be read, as those of another version of this program: "
        "its journal is kept",
        {{"file", unread}});
  }
  std::vector<JournalPose> poses = journal_.read();
  const bool same_run = !poses.empty() && poses.back().run == first.run();
  // A replay that begins at its first sweep is a new one, or starts over.
  const bool goes_on =
      first.replay()
          ? same_run && first.sweep() > 0
          : same_run || (!poses.empty() && runtime::goes_on(first, poses.back().instant_ns,
                                                            runtime::kLongestSearch_ns));
  if (!goes_on) {
    if (!same_run) write_left(poses);
    begin_journal({});
    return;
  }
  const bool to_the_bit = same_run && resume(poses);
  begin_journal(poses);
  take_up(poses, same_run);
  if (to_the_bit) {
    stage_.degraded("state file",
                    state_.write({first.run(), poses.back().sweep, integrator_.state()}));
  }
  if (same_run) {
    catch_up(first);
  } else {
    runtime::report(stage_, {.ns = first.stamp_ns() - last_instant_ns_});
  }
}

void IntegrationStage::write_left(const std::vector<JournalPose>& poses) {
  if (poses.empty()) return;
  if (poses.back().replay) {
    runtime::log_warning("poses of another replay in the journal are dropped: it can be repeated",
                         {{"poses", poses.size()}, {"run", poses.back().run}});
    return;
  }
  Trajectory trajectory, odometry;
  for (const JournalPose& pose : poses) {
    trajectory.push_back({pose.instant_ns, pose.T_map_base});
    odometry.push_back({pose.instant_ns, pose.T_odom_base});
  }
  runtime::log_warning("an instance before left poses of another run, which are written",
                       {{"poses", poses.size()}});
  keep_unwritten(write_run({poses.front().run, false, poses.size()}, trajectory, odometry));
}

// Poses that were published after the newest state are computed again: they are identical, and
// readers drop the copies.
bool IntegrationStage::resume(std::vector<JournalPose>& poses) {
  const auto saved = state_.read(poses.back().run, poses.back().sweep);
  if (!saved) return false;
  const bool resumed = integrator_.resume(saved->words) && integrator_.last_sweep() == saved->sweep;
  if (resumed && drop_after(poses, saved->run, saved->sweep)) return true;
  integrator_.reset();
  return false;
}

void IntegrationStage::take_up(const std::vector<JournalPose>& poses, bool same_run) {
  for (const JournalPose& pose : poses) {
    trajectory_.push_back({pose.instant_ns, pose.T_map_base});
    odometry_.push_back({pose.instant_ns, pose.T_odom_base});
  }
  run_.id = poses.front().run;
  const JournalPose& last = poses.back();
  OdometryPose pose;
  pose.sweep = last.sweep;
  pose.instant_ns = last.instant_ns;
  // In another run it is unknown whether the odometry continued: with a different epoch the next
  // pose is predicted from this one.
  pose.odom_epoch = same_run ? last.odom_epoch : ~last.odom_epoch;
  pose.T_odom_base = last.T_odom_base;
  if (integrator_.last_sweep() != last.sweep) integrator_.restore(pose, last.T_map_base);
  if (!same_run) integrator_.new_run();
  next_sweep_ = same_run ? last.sweep + 1 : 0;
  last_instant_ns_ = last.instant_ns;
  unsaved_ = true;
  runtime::log_warning("resuming the trajectory of the previous instance",
                       {{"poses", poses.size()}, {"sweep", next_sweep_}});
}

void IntegrationStage::catch_up(const msg::Header& first) {
  const std::int64_t killed_ns = last_instant_ns_;
  if (first.replay()) ack_.done_below(first.run(), next_sweep_);
  // All corrections that later poses may need.
  for (const CorrectionMessage& correction : runtime::recall<msg::MapCorrection>(
           stage_, Key::kMapCorrection, runtime::sweeps_from(first.run(), 0), kTries)) {
    take(correction);
  }
  runtime::Gap gap;
  for (const OdometryMessage& pose : runtime::recall<msg::Odometry>(
           stage_, Key::kOdometry, runtime::sweeps_from(first.run(), next_sweep_), kTries)) {
    // A replay drops nothing: the rest arrives in order by itself.
    if (gap.add(next_sweep_, pose.sweep()) && first.replay()) break;
    process(pose);
  }
  if (first.replay()) {
    inlet_->continue_at(first.run(), next_sweep_);
    return;
  }
  gap.ns = std::max<std::int64_t>(0, first.stamp_ns() - killed_ns);
  runtime::report(stage_, gap);
}

}  // namespace zloam::integration
