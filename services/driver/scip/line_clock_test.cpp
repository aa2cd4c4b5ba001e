// The counter against the receive times over hours: drift, wrap and restarts.

#include "driver/scip/line_clock.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace zloam::driver::scip {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kHostZeroNs = 1'700'000'000'000 * kMs;
constexpr std::int64_t kTurnNs = 25 * kMs;
constexpr std::int64_t kSentAfterNs = 18'750'000;
// Only each tenth line, which is enough for the clock.
constexpr std::int64_t kApartNs = 10 * kTurnNs;
// Longer than the 24 bits of the counter last.
constexpr std::int64_t kHours = 5;

/// A scanner whose counter runs at its own rate, and a clock that reads its lines.
class Hours {
 public:
  explicit Hours(double fast_ppm)
      : fast_ppm_(fast_ppm), clock_(kTurnNs, std::vector<LineArrival>{line()}) {
    place();
  }

  void pass_hours() {
    for (std::int64_t i = 0; i < kHours * 3600 * 1'000 * kMs / kApartNs; ++i) place();
  }
  /// Places the next line; its error against the true time since the first line, ms.
  double place() {
    const std::int64_t stamp_ns = clock_.place(line());
    if (at_ns_ == 0) first_ns_ = stamp_ns;
    const double error_ms = 1e-6 * static_cast<double>(stamp_ns - first_ns_ - at_ns_);
    at_ns_ += kApartNs;
    return error_ms;
  }
  void set_counter_ahead(std::int64_t ms) { set_ms_ += ms; }
  std::uint32_t counter_ms() const {
    const double run_ms = 1e-6 * static_cast<double>(at_ns_) * (1.0 + 1e-6 * fast_ppm_);
    return static_cast<std::uint32_t>((std::llround(std::floor(run_ms)) + set_ms_) & 0xFFFFFF);
  }
  std::uint64_t steps() const { return clock_.steps(); }

 private:
  LineArrival line() const {
    return {counter_ms(), kSentAfterNs, kHostZeroNs + at_ns_ + kSentAfterNs + kMs};
  }

  double fast_ppm_;
  std::int64_t at_ns_ = 0;
  std::int64_t set_ms_ = 1'000;
  std::int64_t first_ns_ = 0;
  LineClock clock_;
};

TEST(ScipLineClock, DriftOverHoursIsNoRestart) {
  for (const double ppm : {-90.0, 0.0, 90.0}) {
    SCOPED_TRACE(ppm);
    Hours hours(ppm);
    hours.pass_hours();
    EXPECT_EQ(hours.steps(), 0U);
    // The drift of the last ten seconds is followed afterwards.
    EXPECT_NEAR(hours.place(), 0.0, 5.0);
  }
}

TEST(ScipLineClock, ARestartIsNoticedAfterHoursOfDrift) {
  for (const double ppm : {-90.0, 90.0}) {
    SCOPED_TRACE(ppm);
    Hours hours(ppm);
    hours.pass_hours();
    hours.set_counter_ahead(300 - static_cast<std::int64_t>(hours.counter_ms()));
    hours.place();
    EXPECT_EQ(hours.steps(), 1U);
    hours.place();
    EXPECT_EQ(hours.steps(), 1U);
  }
}

TEST(ScipLineClock, ACounterThatJumpsAheadIsNoticedAfterHoursOfDrift) {
  for (const double ppm : {-90.0, 90.0}) {
    SCOPED_TRACE(ppm);
    Hours hours(ppm);
    hours.pass_hours();
    hours.set_counter_ahead(1'500);
    hours.place();
    EXPECT_EQ(hours.steps(), 1U);
  }
}

TEST(ScipLineClock, LinesThatWereHeldUpAreNoRestart) {
  const auto line = [](std::int64_t i, std::int64_t late_ns) {
    return LineArrival{static_cast<std::uint32_t>(25 * i), kSentAfterNs,
                       kHostZeroNs + kTurnNs * i + kSentAfterNs + late_ns};
  };
  LineClock clock(kTurnNs, std::vector<LineArrival>{line(0, 0)});
  for (std::int64_t i = 0; i < 400; ++i) clock.place(line(i, 0));
  // Five seconds of lines arrive together.
  for (std::int64_t i = 400; i < 600; ++i) clock.place(line(i, kTurnNs * (600 - i)));
  for (std::int64_t i = 600; i < 800; ++i) clock.place(line(i, 0));
  EXPECT_EQ(clock.steps(), 0U);
}

}  // namespace
}  // namespace zloam::driver::scip
