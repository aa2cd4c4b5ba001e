#include "common/runtime/host_clock.hpp"

#include <algorithm>

namespace zloam::runtime {
namespace {
constexpr std::size_t kKept = 16;
}

void HostClock::add(const TimeExchange& e) {
  const std::int64_t there_ns = e.sent_ns - e.received_ns;
  const std::int64_t round_trip_ns = e.answered_ns - e.asked_ns - there_ns;
  if (round_trip_ns < 0 || there_ns < 0) return;
  const std::int64_t sum_ns = (e.received_ns - e.asked_ns) + (e.sent_ns - e.answered_ns);
  last_.push_back({sum_ns / 2, (round_trip_ns + 1) / 2});
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
