// A host's clock that is set while a motor's program stamps its readings with it.

#include "driver/spinning/host_steps.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "driver/spinning/sweeps.hpp"

namespace zloam::driver::spinning {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kZero = 1'700'000'000'000 * kMs;

/// Readings of 10 s, every 2 ms, each arriving 3 ms later; after 5 s the clock is set.
struct Motor {
  explicit Motor(std::int64_t step) : step_ns(step) {}
  std::int64_t step_ns;

  std::int64_t wall_ns(std::int64_t true_ns) const {
    return true_ns + (true_ns >= kZero + 5000 * kMs ? step_ns : 0);
  }

  /// Errors of the moved stamps.
  std::vector<std::int64_t> off_ns(HostSteps& steps) const {
    std::vector<std::int64_t> off;
    for (std::int64_t taken_ns = kZero; taken_ns < kZero + 10'000 * kMs; taken_ns += 2 * kMs) {
      const std::int64_t arrives_ns = taken_ns + 3 * kMs;
      steps.look(wall_ns(arrives_ns) - arrives_ns, arrives_ns);
      off.push_back(steps.even_ns(wall_ns(taken_ns), arrives_ns) - taken_ns);
    }
    return off;
  }
};

TEST(HostStepsTest, EveryReadingKeepsItsTimeAcrossAStep) {
  for (const std::int64_t step_ms : {5000, 300, 5, -5, -300, -2000, -3'600'000}) {
    SCOPED_TRACE(step_ms);
    HostSteps steps;
    for (const std::int64_t off_ns : Motor(step_ms * kMs).off_ns(steps)) ASSERT_EQ(off_ns, 0);
    EXPECT_EQ(steps.count(), 1U);
    EXPECT_EQ(steps.take_step_ns(), step_ms * kMs);
    EXPECT_EQ(steps.take_step_ns(), 0);
    EXPECT_EQ(steps.ahead_ns(), step_ms * kMs);
  }
}

TEST(HostStepsTest, AfterAStepShorterThanTheDelayTheTimesAreRightAgainWithinASecond) {
  HostSteps steps;
  const std::vector<std::int64_t> off_ns = Motor(2 * kMs).off_ns(steps);
  ASSERT_EQ(off_ns.size(), 5000U);
  for (std::size_t i = 0; i < off_ns.size(); ++i) {
    if (i < 2500 || i > 3000) {
      ASSERT_EQ(off_ns[i], 0) << i;
    }
  }
  EXPECT_EQ(steps.count(), 1U);
}

TEST(HostStepsTest, AnErrorOfReadingBothClocksIsNoStep) {
  HostSteps steps;
  for (const std::int64_t error_ns : {90'000, -90'000, 0}) steps.look(error_ns, kZero);
  EXPECT_EQ(steps.count(), 0U);
  EXPECT_EQ(steps.even_ns(kZero, kZero + kMs), kZero);
}

TEST(HostStepsTest, AMotorThatRunsByTheClockFollowsItsStep) {
  // One second of a turning motor's profile later, the host's clock was set by half a second.
  SpinningConfig config;
  config.profile = MotorProfile{1e-9 * static_cast<double>(kZero), 90.0 * kDegree, 0.0, 0.0};
  SpinningSweeps sweeps(config);
  sweeps.set_host_ahead(500 * kMs);
  scip::Parameters scanner;
  scanner.least_mm = 23;
  scanner.most_mm = 60000;
  scanner.steps_per_turn = 1440;
  scanner.last_step = 1080;
  scanner.front_step = 540;
  scanner.turns_per_minute = 2400;
  scip::TimedScan line;
  // Step 900 is 90 degrees to the left, 15.625 ms after step 0.
  line.stamp_ns = kZero + 1000 * kMs - 15'625'000;
  line.scan.request.first_step = line.scan.request.last_step = 900;
  line.scan.echoes.push_back({900, 0, 4000, 0});
  sweeps.add(line, scanner);
  sweeps.flush();
  DecodedSweep sweep;
  ASSERT_TRUE(sweeps.take(sweep));
  ASSERT_EQ(sweep.points.size(), 1U);
  EXPECT_NEAR(sweep.points.front().y, 4.0 * std::cos(135.0 * kDegree), 1e-4);
  EXPECT_NEAR(sweep.points.front().z, 4.0 * std::sin(135.0 * kDegree), 1e-4);
}

}  // namespace
}  // namespace zloam::driver::spinning
