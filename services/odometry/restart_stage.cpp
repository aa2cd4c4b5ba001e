// An odometry that was killed and started again (docs/protocol.md, section 7): its last commits are
// what mapping keeps of odometry/features, its inputs since then what registration keeps.

#include <algorithm>
#include <map>
#include <optional>
#include <string>

#include "common/runtime/recall.hpp"
#include "odometry/odometry_stage.hpp"

namespace zloam::odometry {
namespace {

using Commit = runtime::Received<msg::OdometryFeatures>;
using Features = runtime::Received<msg::Features>;

// A replay waits for whoever asks; live, as long as the queue holds what comes.
constexpr int kReplayTries = 5;
constexpr std::chrono::milliseconds kLinks{500};
// More than the sweeps that a queue may hold and drop while everybody works.
constexpr std::int64_t kStandstill_ns = 700'000'000;
// A frame of fewer sweeps hardly knows its motion, and a sweep that comes after more than so many of
// the usual intervals would be matched as if the platform stood: what a process that stood still
// finds in its queue comes with such holes.
constexpr std::size_t kYoungSweeps = 3;
constexpr double kHole = 2.5;
// Intervals that the usual one is the median of.
constexpr std::size_t kUsualOf = 15;

bool is_slice(const Commit& commit) { return commit->slices() > 1; }

// What the odometry itself said: where it had nothing to say, the message has the source's word.
Health own_health(Health published) {
  const bool own = published == Health::kEmpty || published == Health::kPredicted ||
                   published == Health::kDegenerate;
  return own ? published : Health::kOk;
}

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

/// What registration still has of these sweeps.
std::vector<Features> recall_features(runtime::Stage& stage, const std::string& sweeps) {
  return runtime::recall<msg::Features>(stage, Key::kFeatures, sweeps, 1);
}

/// Of a sweep and all after it.
std::vector<Features> kept_features(runtime::Stage& stage, std::uint64_t run, std::uint64_t first) {
  return recall_features(stage, runtime::sweeps_from(run, first));
}

template <class Messages>
void note_epochs(const Messages& messages, std::optional<std::uint32_t>& greatest) {
  for (const auto& message : messages) {
    greatest = std::max(greatest.value_or(0), message.header().odom_epoch());
  }
}

}  // namespace

void OdometryStage::restart(const msg::Header& first) {
  // Once their readers are there, who keeps nothing answers at once; at the first sweep of a run
  // nobody can keep anything of it.
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
  // The turns that a frame of slices begins with are not in the messages.
  const bool in_slices = std::any_of(commits.begin(), commits.end(), is_slice);
  if (first.replay() && !in_slices) return;
  begin_frame(first, commits);
  // The queue may have given up meanwhile what registration still has.
  if (waited) do_again(first.run(), first.sweep());
  if (!first.replay()) go_on(first);
}

// Live, nothing is waited for that is missing before this sweep: the gap is reported.
void OdometryStage::go_on(const msg::Header& first) {
  const std::uint64_t live = std::max(next_sweep_, first.sweep() + 1);
  inlet_->continue_at(first.run(), first.replay() ? next_sweep_ : live);
}

void OdometryStage::begin_frame(const msg::Header& first, const std::vector<Commit>& commits) {
  // An epoch that was used must not come again: mapping would take its correction for this frame's.
  std::optional<std::uint32_t> used;
  note_epochs(commits, used);
  note_epochs(runtime::recall<msg::Odometry>(stage_, Key::kOdometry, runtime::kKept, 1), used);
  note_epochs(runtime::recall<msg::MapPose>(stage_, Key::kMapOdometry, {}, 1), used);
  if (!used) return;
  odom_epoch_ = *used + 1;
  runtime::log_warning("a new odom frame begins: the one before could not be continued",
                       {{"odom_epoch", odom_epoch_}, {"sweep", first.sweep()}});
}

// Registration keeps what came while nobody was here: a container takes its seconds to start. Only
// what is gone there too has to be told by a constant motion.
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

// The last commit came through to mapping; its pose, on another connection, may have died with its
// publisher. Whoever has it drops the copy by its number.
void OdometryStage::publish_again(std::uint64_t run, const std::vector<CommittedSweep>& sweeps) {
  if (sweeps.size() < 2) return;
  const std::uint64_t last = sweeps.back().sweep;
  const auto kept = recall_features(stage_, runtime::sweeps_from(run, last, last));
  if (kept.empty()) return;
  restore(sweeps.size() - 1, sweeps);
  locate(kept.front(), input_of(kept.front()));
}

std::size_t OdometryStage::take_up(const std::vector<Commit>& commits) {
  std::vector<CommittedSweep> sweeps;
  sweeps.reserve(commits.size());
  for (const Commit& commit : commits) sweeps.push_back(committed(commit));
  publish_again(commits.back().run(), sweeps);
  restore(sweeps.size(), sweeps);
  return commits.size();
}

// From the end of a turn, but not of the last commit, so that it comes again: what follows is done
// once more, to the same bytes, and whoever has it drops the copies.
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

// What came while nobody was here, as far as it can still be had. In a replay the rest comes by
// itself: nothing is given up.
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

// Mapping then searches for the new frame in its map; what a constant motion makes of seconds is
// tens of metres astray, and a map that is left so is never found again.
void OdometryStage::break_frame(std::uint64_t sweep) {
  next_frame();
  runtime::log_warning("a new odom frame begins: nothing came for too long before this sweep",
                       {{"odom_epoch", odom_epoch_}, {"sweep", sweep}});
}

}  // namespace zloam::odometry
