#include "common/runtime/seen_numbers.hpp"

#include <algorithm>

namespace zloam::runtime {
namespace {

constexpr std::int64_t kMaxWait_ns = 8'000'000'000;
// Default time after which missing numbers are given up: one period of a typical lidar, because
// keys without sweeps have no period to measure.
constexpr std::int64_t kDefaultLate_ns = 100'000'000;
// Requests for what a publisher sent before its successor.
constexpr int kSuccessorAttempts = 3;

}  // namespace

std::optional<Drop> SeenNumbers::add(const std::string& instance, std::uint64_t seq, bool replay,
                                     std::int64_t now_ns) {
  replay_ = replay;
  Publisher& p = publisher(instance, seq);
  if (!in_reach(p, seq)) return Drop::kInvalid;
  if (seq < p.below || !p.above.insert(seq).second) return Drop::kDuplicate;
  while (p.above.erase(p.below) > 0) ++p.below;
  while (p.above.size() > kMemory) give_up(p);
  note_gap(now_ns);
  return std::nullopt;
}

SeenNumbers::Publisher& SeenNumbers::publisher(const std::string& instance, std::uint64_t seq) {
  const bool is_new = !publishers_.contains(instance);
  if (is_new && publishers_.size() >= kMostPublishers) {
    const auto oldest = std::min_element(
        publishers_.begin(), publishers_.end(),
        [](const auto& a, const auto& b) { return a.second.heard < b.second.heard; });
    if (gap_ && gap_->instance == oldest->first) gap_.reset();
    publishers_.erase(oldest);
    ++forgotten_;
  }
  Publisher& p = publishers_[instance];
  if (is_new) p.below = seq;
  p.heard = ++heard_;
  return p;
}

bool SeenNumbers::in_reach(Publisher& p, std::uint64_t seq) {
  const std::uint64_t distance = seq < p.below ? p.below - seq : seq - p.below;
  if (distance <= 2 * kMemory) {
    p.far_next.reset();
    return true;
  }
  const bool follows = p.far_next == seq;
  p.far_next = seq + 1;
  if (!follows) return false;
  p.below = seq;
  p.above.clear();
  p.far_next.reset();
  return true;
}

/// Gives up the publisher's lowest missing numbers; there must be some.
void SeenNumbers::give_up(Publisher& p) {
  lost_ += *p.above.begin() - p.below;
  p.below = *p.above.begin();
  while (p.above.erase(p.below) > 0) ++p.below;
}

void SeenNumbers::note_gap(std::int64_t now_ns) {
  const auto found = std::find_if(publishers_.begin(), publishers_.end(),
                                  [](const auto& entry) { return !entry.second.above.empty(); });
  if (found == publishers_.end()) {
    gap_.reset();
    return;
  }
  const Publisher& p = found->second;
  const bool known = gap_ && gap_->instance == found->first && gap_->first == p.below;
  if (!known) {
    const std::int64_t wait_ns = replay_ ? limits_.gap_replay_ns : limits_.gap_live_ns;
    gap_ = Gap{found->first, p.below, 0, now_ns, now_ns + wait_ns, wait_ns, 0};
  }
  gap_->last = *p.above.begin() - 1;
}

std::int64_t SeenNumbers::late_ns() const {
  return limits_.late_ns > 0 ? limits_.late_ns : kDefaultLate_ns;
}

bool SeenNumbers::is_hopeless(const Gap& gap, std::int64_t now_ns) const {
  if (gives_up()) return now_ns - gap.since_ns >= late_ns();
  // Its publisher has gone, and nobody had kept them: the successor's gaps would wait for ever.
  const bool replaced = publishers_.at(gap.instance).heard < heard_;
  return replaced && gap.asked >= kSuccessorAttempts && now_ns >= gap.ask_at_ns;
}

std::optional<SeenNumbers::Request> SeenNumbers::request(std::int64_t now_ns) {
  while (gap_ && is_hopeless(*gap_, now_ns)) {
    give_up(publishers_[gap_->instance]);
    note_gap(now_ns);
  }
  if (!limits_.by_number || !gap_ || now_ns < gap_->ask_at_ns) return std::nullopt;
  ++gap_->asked;
  gap_->wait_ns = std::min(gap_->wait_ns * 2, kMaxWait_ns);
  gap_->ask_at_ns = now_ns + gap_->wait_ns;
  return Request{gap_->first, gap_->last};
}

std::optional<std::int64_t> SeenNumbers::deadline() const {
  if (!gap_) return std::nullopt;
  const std::int64_t late_at_ns = gap_->since_ns + late_ns();
  if (!limits_.by_number) return late_at_ns;
  return replay_ ? gap_->ask_at_ns : std::min(gap_->ask_at_ns, late_at_ns);
}

std::optional<std::uint64_t> SeenNumbers::overdue(std::int64_t now_ns) const {
  if (gives_up() || !gap_ || now_ns - gap_->since_ns < limits_.replay_limit_ns) {
    return std::nullopt;
  }
  return gap_->first;
}

}  // namespace zloam::runtime
