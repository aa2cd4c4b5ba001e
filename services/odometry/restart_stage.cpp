// Restart of odometry after a kill (docs/protocol.md, section 7): mapping keeps its last commits
// (odometry/features), registration the inputs since then.

#include <algorithm>
#include <map>
#include <optional>
#include <string>

#include "common/runtime/recall.hpp"
#include "odometry/odometry_stage.hpp"
#include "odometry/published_health.hpp"

namespace zloam::odometry {
namespace {

using Commit = runtime::Received<msg::OdometryFeatures>;
using Features = runtime::Received<msg::Features>;

// Requests for commits in a replay, which waits for them, and time for the links to come up, during
// which a live queue still holds the arriving sweeps.
constexpr int kReplayTries = 5;
constexpr std::chrono::milliseconds kLinks{500};
// After a longer gap this process stood still: a queue drops fewer sweeps while all stages work.
constexpr std::int64_t kStandstill_ns = 700'000'000;
// A frame of fewer than kYoungSweeps hardly knows its motion: a sweep more than kHole usual
// intervals after the last one would be matched as if the platform stood still. A process that
// stood still finds sweeps with such gaps in its queue.
constexpr std::size_t kYoungSweeps = 3;
constexpr double kHole = 2.5;
// Number of intervals of which the usual one is the median.
constexpr std::size_t kUsualOf = 15;

bool is_slice(const Commit& commit) { return commit->slices() > 1; }

CommittedSweep committed(const Commit& commit) {
  CommittedSweep sweep;
  sweep.sweep = commit.sweep();
  sweep.prev_sweep = commit->prev_sweep();
  sweep.instant_ns = commit->instant_ns();
  sweep.period_ns = commit->period_ns();
  sweep.T_odom_base = pose_of(commit->pose_odom_base());
  sweep.twist_per_s = twist_of(commit->twist());
  sweep.health = own_health(health_of(commit->health()));
  sweep.fit = commit->fit();
  sweep.state_covariance = state_covariance_of(commit->state_covariance());
  sweep.planes = points_of(commit->planes());
  if (commit->inertial_state() != nullptr) {
    sweep.inertia = unpacked(numbers_of(commit->inertial_state()));
  }
  return sweep;
}

/// The features of these sweeps that registration still has.
std::vector<Features> recall_features(runtime::Stage& stage, const std::string& sweeps) {
  return runtime::recall<msg::Features>(stage, Key::kFeatures, sweeps, 1);
}

/// The features of sweep `first` and of all later ones.
std::vector<Features> kept_features(runtime::Stage& stage, std::uint64_t run, std::uint64_t first) {
  return recall_features(stage, runtime::sweeps_from(run, first));
}

}  // namespace

void OdometryStage::restart(const msg::Header& first) {
  // Once the subscribers are connected, one that keeps nothing answers at once. At the first sweep
  // of a run nothing of it can have been kept.
  const auto linked = [this] { return pose_.matching() && features_.matching(); };
  const bool waited = first.sweep() > 0 && !linked();
  if (waited) runtime::wait_for_links(linked, kLinks);
  const int tries = first.replay() ? kReplayTries : 1;
  const auto commits =
      runtime::recall<msg::OdometryFeatures>(stage_, Key::kOdometryFeatures, runtime::kKept, tries);
  if (const auto until_ns = continue_frame(first, commits)) {
    catch_up(first, *until_ns);
    return;
  }
  // In the first revolutions of a frame of slices the commits carry no state, so that it cannot be
  // continued even in a replay.
  const bool in_slices = std::any_of(commits.begin(), commits.end(), is_slice);
  if (first.replay() && !in_slices) return;
  begin_frame(first, commits);
  // While waiting, the queue may have dropped sweeps that registration still has.
  if (waited) do_again(first.run(), first.sweep());
  if (!first.replay()) go_on(first);
}

// Live, sweeps that are missing before this one are not waited for: the gap is reported.
void OdometryStage::go_on(const msg::Header& first) {
  const std::uint64_t live = std::max(next_sweep_, first.sweep() + 1);
  inlet_->continue_at(first.run(), first.replay() ? next_sweep_ : live);
}

void OdometryStage::begin_frame(const msg::Header& first, const std::vector<Commit>& commits) {
  const auto used = runtime::used_odom_epoch(stage_, commits);
  if (!used) return;
  odom_epoch_ = *used + 1;
  runtime::log_warning("a new odom frame begins: the one before could not be continued",
                       {{"odom_epoch", odom_epoch_}, {"sweep", first.sweep()}});
}

// A container takes seconds to start, but registration keeps the sweeps of that time: only the gap
// before the first kept sweep must be bridged by constant motion.
bool OdometryStage::reaches(const msg::Header& first, const CommittedSweep& last) const {
  if (runtime::goes_on(first, last.instant_ns)) return true;
  const auto kept = kept_features(stage_, first.run(), last.sweep + 1);
  return !kept.empty() && runtime::goes_on(kept.front().header(), last.instant_ns);
}

void OdometryStage::restore(std::size_t count, const std::vector<CommittedSweep>& sweeps) {
  const std::size_t depth = std::min(count, odometry_.restore_depth());
  const auto end = sweeps.begin() + static_cast<std::ptrdiff_t>(count);
  odometry_.restore({end - static_cast<std::ptrdiff_t>(depth), end});
}

// Mapping has received the last commit, but its pose, sent on another connection, may be lost with
// the killed publisher. Receivers that have the pose drop the copy by its number.
void OdometryStage::publish_again(std::uint64_t run, const std::vector<CommittedSweep>& sweeps) {
  const std::uint64_t last = sweeps.back().sweep;
  // The first sweep of a frame needs none before it.
  if (sweeps.size() < 2 && sweeps.back().prev_sweep != last) return;
  const auto kept = recall_features(stage_, runtime::sweeps_from(run, last, last));
  if (kept.empty()) return;
  restore(sweeps.size() - 1, sweeps);
  locate(kept.front(), input_of(kept.front()));
}

std::size_t OdometryStage::take_up(const std::vector<Commit>& commits) {
  std::vector<CommittedSweep> sweeps;
  sweeps.reserve(commits.size());
  for (const Commit& commit : commits) {
    // Poses of an earlier frame say nothing in this one.
    if (commit.header().odom_epoch() == odom_epoch_) sweeps.push_back(committed(commit));
  }
  publish_again(commits.back().run(), sweeps);
  restore(sweeps.size(), sweeps);
  return commits.size();
}

// Continues from the end of a revolution before the last commit, so that this commit is published
// again: the slices since then are processed again to the same bytes, and receivers drop the
// copies.
std::size_t OdometryStage::take_up_slices(const std::vector<Commit>& commits) {
  const auto from =
      std::find_if(commits.rbegin() + 1, commits.rend(), [this](const Commit& commit) {
        return commit->state() != nullptr && commit.header().odom_epoch() == odom_epoch_;
      });
  if (from == commits.rend()) return 0;
  std::map<std::uint64_t, Features> kept;
  const std::uint64_t last = from->sweep();
  for (Features& f : recall_features(stage_, runtime::sweeps_from(from->run(), 0, last))) {
    kept.emplace(f.sweep(), std::move(f));
  }
  const auto slice_at = [&](std::uint64_t sweep) -> std::optional<FeatureSweep> {
    const auto found = kept.find(sweep);
    if (found == kept.end()) return std::nullopt;
    // Its points were chosen with the settings in force at it.
    if (stage_.configure_for(found->second)) odometry_.configure(config_);
    return input_of(found->second);
  };
  if (!odometry_.restore_slices(numbers_of((*from)->state()), slice_at)) return 0;
  return static_cast<std::size_t>(commits.rend() - from);
}

std::optional<std::int64_t> OdometryStage::continue_frame(const msg::Header& first,
                                                          std::vector<Commit> commits) {
  std::erase_if(commits, [&](const Commit& commit) { return commit.run() != first.run(); });
  if (commits.empty()) return std::nullopt;
  if (!first.replay() && !reaches(first, committed(commits.back()))) return std::nullopt;
  const std::int64_t until_ns = commits.back()->instant_ns();
  odom_epoch_ = commits.back().header().odom_epoch();
  const std::size_t count = is_slice(commits.back()) ? take_up_slices(commits) : take_up(commits);
  if (count == 0) return std::nullopt;
  commits.erase(commits.begin() + static_cast<std::ptrdiff_t>(count), commits.end());
  for (const Commit& commit : commits) {
    path_.emplace_back(commit->instant_ns(), commit.sweep(), *commit->pose_odom_base());
    if (commit.header().odom_epoch() == odom_epoch_) ++frame_sweeps_;
  }
  const Commit& last = commits.back();
  done_below_ = next_sweep_ = last.sweep() + 1;
  last_instant_ns_ = last->instant_ns();
  last_header_ = header_fields(last.header());
  runtime::log_warning("resuming the odometry of the previous instance",
                       {{"sweep", next_sweep_}, {"commits", count}});
  return until_ns;
}

void OdometryStage::do_again(std::uint64_t run, std::uint64_t from) {
  for (const Features& features : kept_features(stage_, run, from)) {
    process(features);
  }
}

// Processes the sweeps that came while no instance was running, as far as registration still has
// them. In a replay the rest arrives by itself: nothing is dropped.
void OdometryStage::catch_up(const msg::Header& first, std::int64_t until_ns) {
  runtime::Gap gap;
  for (const Features& features : kept_features(stage_, first.run(), done_below_)) {
    if (gap.add(done_below_, features.sweep()) && first.replay()) break;
    process(features);
  }
  go_on(first);
  if (first.replay()) return;
  gap.add(done_below_, first.sweep());
  gap.ns = std::max<std::int64_t>(0, first.stamp_ns() - until_ns);
  runtime::report(stage_, gap);
}

bool OdometryStage::stood_still_before(const Features& features) const {
  if (features.replay() || path_.empty() || features.sweep() <= done_below_) return false;
  return features.header().stamp_ns() - last_instant_ns_ > kStandstill_ns;
}

std::optional<std::int64_t> OdometryStage::usual_interval_ns() const {
  const std::size_t end = path_.size() - std::min(path_.size(), frame_sweeps_);
  std::vector<std::int64_t> intervals;
  for (std::size_t i = end > kUsualOf ? end - kUsualOf : 1; i < end; ++i) {
    intervals.push_back(path_[i].instant_ns() - path_[i - 1].instant_ns());
  }
  if (intervals.empty()) return std::nullopt;
  const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2);
  std::nth_element(intervals.begin(), middle, intervals.end());
  return *middle;
}

bool OdometryStage::is_too_far(const Features& features) const {
  if (path_.empty()) return false;
  const std::int64_t gap_ns = features.header().stamp_ns() - last_instant_ns_;
  if (gap_ns >= runtime::kLongestGap_ns) return true;
  if (frame_sweeps_ >= kYoungSweeps) return false;
  const auto usual_ns = usual_interval_ns();
  const double interval_ns = static_cast<double>(gap_ns) + features->period_ns();
  return usual_ns && interval_ns > kHole * static_cast<double>(*usual_ns);
}

// Mapping then searches for the new frame in its map. Constant motion over seconds would be off by
// tens of metres, from where mapping would not find its map again.
void OdometryStage::break_frame(std::uint64_t sweep) {
  next_frame();
  runtime::log_warning("a new odom frame begins: nothing came for too long before this sweep",
                       {{"odom_epoch", odom_epoch_}, {"sweep", sweep}});
}

}  // namespace zloam::odometry
