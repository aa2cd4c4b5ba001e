#pragma once
// Time at which a device's lines were measured, from its counter of milliseconds and the receive
// times.

#include <cstdint>
#include <optional>
#include <span>

#include "driver/sweep/clock.hpp"

namespace zloam::driver::scip {

/// One received line.
struct LineArrival {
  /// at step 0, 24 bits
  std::uint32_t counter_ms = 0;
  /// from step 0 to the end of the last step; nothing is sent before
  std::int64_t sent_after_ns = 0;
  /// ns since the Unix epoch; 0: unknown
  std::int64_t received_ns = 0;
};

/// The counter has 24 bits and whole milliseconds; the scanner rotates evenly. So a line is placed
/// whole revolutions after the one before, as far as its counter allows.
class LineClock {
 public:
  /// first: lines of about a second, beginning with the first one; the least delay among them ties
  /// the counter to the host's clock.
  LineClock(std::int64_t turn_ns, std::span<const LineArrival> first);

  /// A better tie of the counter: the device reported this counter at host_ns.
  void tie(std::uint32_t counter_ms, std::int64_t host_ns);

  /// Time of a line's step 0, ns since the Unix epoch. Takes all lines in order.
  std::int64_t place(const LineArrival& line);

  /// Revolutions between the last two lines; 1 when none is missing, 0 within one revolution.
  std::int64_t turns() const { return phase_.turns; }
  /// What the clock of the receive times was set by since the last call; 0: nothing.
  std::int64_t take_host_step_ns() { return clock_.take_host_step_ns(); }
  /// Number of times the counter was set, as by a restart of the device.
  std::uint64_t steps() const { return phase_.steps; }

 private:
  /// State of the device's own time.
  struct Phase {
    bool begun = false;
    std::uint32_t counter_ms = 0;
    std::int64_t unwrapped_ms = 0;
    /// of receive times against the counter, since either clock was set; it follows their drift
    std::optional<std::int64_t> least_delay_ns;
    std::int64_t received_ns = 0;
    std::int64_t step0_ns = 0;
    std::int64_t turns = 1;
    std::uint64_t steps = 0;
  };

  static void unwrap(Phase& phase, const LineArrival& line, std::int64_t turn_ns);
  static void begin_delays(Phase& phase, const LineArrival& line);
  static bool was_set(Phase& phase, const LineArrival& line, std::int64_t apart_ms);
  static std::int64_t advance(Phase& phase, const LineArrival& line, std::int64_t turn_ns);

  std::int64_t turn_ns_;
  SensorClock clock_;
  Phase phase_;
  LineArrival first_;
  std::int64_t first_step0_ns_ = 0;
  std::int64_t shift_ns_ = 0;
};

}  // namespace zloam::driver::scip
