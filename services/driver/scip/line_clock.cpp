#include "driver/scip/line_clock.hpp"

#include <algorithm>
#include <limits>

namespace zloam::driver::scip {
namespace {

constexpr std::uint32_t kCounterMask = 0xFFFFFF;
constexpr std::uint32_t kHalf = 0x800000;
constexpr std::int64_t kMillisecondNs = 1'000'000;
// A counter that is farther ahead of the elapsed time than this was set.
constexpr std::int64_t kAheadNs = 1'000'000'000;
// Counter and host's clock differ in rate by less than one part in this many: quartz by a tenth.
constexpr std::int64_t kDriftParts = 1'000;
// After more missing revolutions, the motor's steady speed no longer determines the phase.
constexpr std::int64_t kMostTurns = 40;

/// (a - b) of two counters, from -2^23 to 2^23 - 1.
std::int64_t counters_apart_ms(std::uint32_t a, std::uint32_t b) {
  const std::uint32_t ahead = (a - b) & kCounterMask;
  return static_cast<std::int64_t>(ahead) - (ahead >= kHalf ? kCounterMask + 1LL : 0);
}

}  // namespace

LineClock::LineClock(std::int64_t turn_ns, std::span<const LineArrival> first)
    : turn_ns_(turn_ns), clock_(ClockMode::kReceive, true) {
  Phase trial;
  std::int64_t least_ns = std::numeric_limits<std::int64_t>::max();
  for (const LineArrival& line : first) {
    const std::int64_t step0_ns = advance(trial, line, turn_ns);
    if (&line == first.data()) {
      first_ = line;
      first_step0_ns_ = step0_ns;
    }
    if (trial.steps == 0 && line.received_ns != 0) {
      least_ns = std::min(least_ns, line.received_ns - line.sent_after_ns - step0_ns);
    }
  }
  const bool known = least_ns != std::numeric_limits<std::int64_t>::max();
  clock_.anchor(first_step0_ns_, 0, known ? first_step0_ns_ + least_ns : 0, 0);
}

void LineClock::tie(std::uint32_t counter_ms, std::int64_t host_ns) {
  // Assumes the middle of the millisecond that the counter shows.
  const std::int64_t apart_ns = counters_apart_ms(first_.counter_ms, counter_ms) * kMillisecondNs -
                                kMillisecondNs / 2 + first_step0_ns_ % kMillisecondNs;
  shift_ns_ = host_ns + apart_ns - clock_.to_epoch_ns(first_step0_ns_);
}

/// The first line since the counter was set is the first whose delay counts, if it is known.
void LineClock::begin_delays(Phase& phase, const LineArrival& line) {
  phase.least_delay_ns.reset();
  if (line.received_ns != 0) {
    phase.least_delay_ns = line.received_ns - phase.unwrapped_ms * kMillisecondNs;
  }
}

/// Whether the counter was set before this line, apart_ms after the one before.
bool LineClock::was_set(Phase& phase, const LineArrival& line, std::int64_t apart_ms) {
  if (apart_ms < 0) return true;
  if (line.received_ns == 0) return false;
  const std::int64_t delay_ns = line.received_ns - (phase.unwrapped_ms + apart_ms) * kMillisecondNs;
  if (!phase.least_delay_ns) {
    phase.least_delay_ns = delay_ns;
    return false;
  }
  if (delay_ns < *phase.least_delay_ns - kAheadNs) return true;
  // A fast counter lowers the least delay line by line. A slow one raises it no faster than
  // kDriftParts, because lines that were held up are late without any drift.
  const std::int64_t passed_ns =
      phase.received_ns == 0 ? 0 : std::max<std::int64_t>(0, line.received_ns - phase.received_ns);
  phase.least_delay_ns = std::min(delay_ns, *phase.least_delay_ns + passed_ns / kDriftParts);
  return false;
}

void LineClock::unwrap(Phase& phase, const LineArrival& line, std::int64_t turn_ns) {
  const std::int64_t apart_ms = counters_apart_ms(line.counter_ms, phase.counter_ms);
  const bool host_went_back = line.received_ns != 0 && line.received_ns < phase.received_ns;
  // Its clock was set, and delays before and after cannot be compared.
  if (host_went_back) {
    phase.least_delay_ns = line.received_ns - phase.unwrapped_ms * kMillisecondNs;
  }
  if (!was_set(phase, line, apart_ms)) {
    phase.unwrapped_ms += apart_ms;
    return;
  }
  // The device was restarted: its time continues by the time that elapsed on the host.
  ++phase.steps;
  const bool known = line.received_ns != 0 && phase.received_ns != 0 && !host_went_back;
  const std::int64_t since_ns = known ? line.received_ns - phase.received_ns : turn_ns;
  phase.unwrapped_ms += std::max<std::int64_t>(1, since_ns / kMillisecondNs);
  begin_delays(phase, line);
}

/// Time of the next line's step 0 on the device's unwrapped clock, ns.
std::int64_t LineClock::advance(Phase& phase, const LineArrival& line, std::int64_t turn_ns) {
  if (phase.begun) {
    unwrap(phase, line, turn_ns);
  } else {
    phase.unwrapped_ms = line.counter_ms & kCounterMask;
    begin_delays(phase, line);
  }
  phase.counter_ms = line.counter_ms & kCounterMask;
  phase.received_ns = line.received_ns;
  const std::int64_t least_ns = phase.unwrapped_ms * kMillisecondNs;
  std::int64_t step0_ns = least_ns + kMillisecondNs / 2;
  if (phase.begun) {
    phase.turns = std::max<std::int64_t>(0, (step0_ns - phase.step0_ns + turn_ns / 2) / turn_ns);
    if (phase.turns <= kMostTurns) {
      step0_ns = std::clamp(phase.step0_ns + phase.turns * turn_ns, least_ns,
                            least_ns + kMillisecondNs - 1);
    }
  }
  phase.begun = true;
  phase.step0_ns = step0_ns;
  return step0_ns;
}

std::int64_t LineClock::place(const LineArrival& line) {
  const std::int64_t step0_ns = advance(phase_, line, turn_ns_);
  clock_.observe(step0_ns, line.received_ns, line.sent_after_ns);
  clock_.advance(step0_ns);
  return clock_.to_epoch_ns(step0_ns) + shift_ns_;
}

}  // namespace zloam::driver::scip
