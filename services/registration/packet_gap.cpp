#include "registration/packet_gap.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::registration {
namespace {

constexpr std::int64_t kHourUs = 3'600'000'000;

}  // namespace

std::int64_t packets_between(const PacketSpan& before, const PacketSpan& after) {
  if (before.period_ns == 0 || after.period_ns == 0) return 0;
  const std::int64_t toh_us = static_cast<std::int64_t>(after.first_toh_us) - before.last_toh_us;
  // Only decides between whole hours, so that the duration of the first sweep does not matter.
  const std::int64_t waited_us = (after.last_received_ns - before.last_received_ns) / 1000;
  const std::int64_t hours =
      std::llround(static_cast<double>(waited_us - toh_us) / static_cast<double>(kHourUs));
  const std::int64_t passed_ns = 1000 * (toh_us + hours * kHourUs);
  const std::int64_t steps = (passed_ns + before.period_ns / 2) / before.period_ns;
  return std::max<std::int64_t>(0, steps - 1);
}

}  // namespace zloam::registration
