#include "common/runtime/host_clock.hpp"

#include <algorithm>
#include <cstdlib>

namespace zloam::runtime {
namespace {
constexpr std::size_t kKept = 16;
// So many exchanges take 16 s, in which a clock that NTP slews drifts by 8 ms (500 ppm).
constexpr std::int64_t kSet_ns = 10'000'000;

/// The offset lies within both, unless a clock was set in between.
bool agree(const ClockOffset& a, const ClockOffset& b) {
  return std::abs(a.offset_ns - b.offset_ns) <= a.uncertainty_ns + b.uncertainty_ns + kSet_ns;
}
}  // namespace

void HostClock::add(const TimeExchange& e) {
  const std::int64_t there_ns = e.sent_ns - e.received_ns;
  const std::int64_t round_trip_ns = e.answered_ns - e.asked_ns - there_ns;
  if (round_trip_ns < 0 || there_ns < 0) return;
  const std::int64_t sum_ns = (e.received_ns - e.asked_ns) + (e.sent_ns - e.answered_ns);
  const ClockOffset latest{sum_ns / 2, (round_trip_ns + 1) / 2};
  if (const auto known = offset(); known && !agree(*known, latest)) last_.clear();
  last_.push_back(latest);
  if (last_.size() > kKept) last_.pop_front();
}

std::optional<ClockOffset> HostClock::offset() const {
  const auto best =
      std::min_element(last_.begin(), last_.end(), [](const ClockOffset& a, const ClockOffset& b) {
        return a.uncertainty_ns < b.uncertainty_ns;
      });
  if (best == last_.end()) return std::nullopt;
  return *best;
}

}  // namespace zloam::runtime
