#include "registration/sharing.hpp"

// xxHash's header-only form, as only one of its functions is used.
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <utility>

namespace zloam::registration {
namespace {

constexpr std::int64_t kMs = 1'000'000;
// Odometry can lead the newest sweep received here only a little, if another replica received
// sweeps sooner. Progress further ahead is not credible.
constexpr std::uint64_t kMostAhead = 64;

}  // namespace

std::uint64_t weight(std::uint64_t run, std::uint64_t sweep, std::string_view instance) {
  std::string input(sizeof sweep, '\0');
  for (std::size_t i = 0; i < sizeof sweep; ++i) {
    input[i] = static_cast<char>((sweep >> (8 * i)) & 0xFF);
  }
  input += instance;
  return XXH64(input.data(), input.size(), run);
}

std::size_t rank(std::uint64_t run, std::uint64_t sweep, std::string_view instance,
                 const std::vector<std::string>& members) {
  const std::uint64_t own = weight(run, sweep, instance);
  const auto before = [&](const std::string& other) {
    const std::uint64_t theirs = weight(run, sweep, other);
    return theirs != own ? theirs > own : std::string_view(other) < instance;
  };
  return static_cast<std::size_t>(std::count_if(members.begin(), members.end(), before));
}

bool Sharing::first(std::uint64_t run, std::uint64_t sweep) const {
  return rank(run, sweep, instance_, members_) == 0;
}

bool Sharing::done(const SweepToShare& sweep) const {
  return sweep.run == progress_.run && sweep.sweep < progress_.next_sweep &&
         progress_.next_sweep <= newest_ + kMostAhead;
}

bool Sharing::received(const SweepToShare& sweep) const {
  if (done(sweep)) return true;
  if (sweep.run != progress_.run || sweep.sweep >= progress_.received_below) return false;
  const auto& missing = progress_.missing;
  return std::find(missing.begin(), missing.end(), sweep.sweep) == missing.end();
}

bool Sharing::full() const {
  return held_.size() > static_cast<std::size_t>(config_.hold_sweeps) ||
         held_bytes_ > static_cast<std::size_t>(config_.hold_mib) << 20;
}

Sharing::Share Sharing::take(const SweepToShare& sweep, std::int64_t now_ns) {
  newest_ = sweep.run == run_ ? std::max(newest_, sweep.sweep) : sweep.sweep;
  run_ = sweep.run;
  if (done(sweep)) return Share::kNotMine;
  if (first(sweep.run, sweep.sweep)) return Share::kCompute;
  held_.push_back({sweep, now_ns});
  held_bytes_ += sweep.bytes;
  return Share::kHold;
}

void Sharing::set_members(std::vector<std::string> members) { members_ = std::move(members); }

void Sharing::set_progress(Progress progress) { progress_ = std::move(progress); }

bool Sharing::redo(const Held& held, std::int64_t now_ns) const {
  const std::size_t place = rank(held.sweep.run, held.sweep.sweep, instance_, members_);
  // A sweep that odometry has received is not computed again, even if it is not processed yet.
  if (received(held.sweep)) return false;
  const std::int64_t patience_ns =
      kMs * (held.sweep.replay ? config_.redo_replay_ms : config_.redo_live_ms);
  return now_ns - held.arrived_ns >= static_cast<std::int64_t>(place) * patience_ns;
}

std::optional<Sharing::Due> Sharing::settle(const Held& held, std::int64_t now_ns) const {
  const SweepToShare& sweep = held.sweep;
  // A newer run has begun, and odometry no longer waits for sweeps of this one.
  if (sweep.run != run_ || done(sweep)) return Due{sweep.run, sweep.sweep, false};
  if (redo(held, now_ns)) return Due{sweep.run, sweep.sweep, true};
  return std::nullopt;
}

std::vector<Sharing::Due> Sharing::due(std::int64_t now_ns) {
  std::vector<Due> settled;
  std::vector<Held> kept;
  for (const Held& held : held_) {
    if (const auto due = settle(held, now_ns)) {
      settled.push_back(*due);
      held_bytes_ -= held.sweep.bytes;
    } else {
      kept.push_back(held);
    }
  }
  held_ = std::move(kept);
  while (full()) settled.push_back(let_go());
  return settled;
}

/// Drops the oldest sweep to make room. In a live run nothing waits for it any more; in a replay it
/// is computed, so that none is lost.
Sharing::Due Sharing::let_go() {
  const SweepToShare oldest = held_.front().sweep;
  held_.erase(held_.begin());
  held_bytes_ -= oldest.bytes;
  return {oldest.run, oldest.sweep, oldest.replay && !received(oldest)};
}

}  // namespace zloam::registration
