#pragma once
// When a device's lines were measured, from its counter of milliseconds and the times at which they
// were received.

#include <cstdint>
#include <optional>
#include <span>

#include "driver/sweep/clock.hpp"

namespace zloam::driver::scip {

/// One line as it came.
struct LineArrival {
  /// at step 0, 24 bits
  std::uint32_t counter_ms = 0;
  /// from step 0 until the last step was measured, before which nothing is sent
  std::int64_t sent_after_ns = 0;
  /// ns since the Unix epoch; 0: unknown
  std::int64_t received_ns = 0;
};

/// The counter has 24 bits and whole milliseconds; the scanner turns evenly. So a line is where the
/// turns lead from the one before, as far as its counter allows.
class LineClock {
 public:
  /// first: lines of about a second, from the first one on; the least delay among them ties the
  /// counter to the host's clock.
  LineClock(std::int64_t turn_ns, std::span<const LineArrival> first);

  /// Ties the counter better than that: the device told this counter at host_ns.
  void tie(std::uint32_t counter_ms, std::int64_t host_ns);

  /// A line's step 0, ns since the Unix epoch. The lines in their order, from the first one on.
  std::int64_t place(const LineArrival& line);

  /// Turns between the last two lines; 1 when none is missing.
  std::int64_t turns() const { return phase_.turns; }
  /// How often the counter was set, as by a restart of the device.
  std::uint64_t steps() const { return phase_.steps; }

 private:
  /// Of the device's own time.
  struct Phase {
    bool begun = false;
    std::uint32_t counter_ms = 0;
    std::int64_t unwrapped_ms = 0;
    /// of the first line since the counter was last set
    std::int64_t first_ms = 0;
    std::int64_t first_received_ns = 0;
    std::int64_t received_ns = 0;
    std::int64_t step0_ns = 0;
    std::int64_t turns = 1;
    std::uint64_t steps = 0;
  };

  static void unwrap(Phase& phase, const LineArrival& line, std::int64_t turn_ns);
  static std::int64_t advance(Phase& phase, const LineArrival& line, std::int64_t turn_ns);

  std::int64_t turn_ns_;
  SensorClock clock_;
  Phase phase_;
  LineArrival first_;
  std::int64_t first_step0_ns_ = 0;
  std::int64_t shift_ns_ = 0;
};

}  // namespace zloam::driver::scip
