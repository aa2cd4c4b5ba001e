// The motor's time for all directions, measured, and what is told of it.

#include "driver/spinning/turn_watch.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>
#include <optional>

#include "driver/spinning/sweeps.hpp"

namespace zloam::driver::spinning {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::int64_t kMs = 1'000'000;
// Arbitrary origin of all stamps.
constexpr std::int64_t kZero = 1'700'000'000'000 * kMs;

/// The time that TurnWatch measures for a motor with this angle over time, read every 2 ms.
std::optional<double> watched(double seconds, const std::function<double(double)>& degrees) {
  TurnWatch watch;
  for (int i = 0; i < static_cast<int>(500.0 * seconds); ++i) {
    watch.add({kZero + 2 * kMs * i, kDegree * degrees(0.002 * i)});
  }
  return watch.turn_s();
}

TEST(TurnWatchTest, ASwingFromReversalToReversal) {
  // 90 degrees to either side, at 120 degrees per second.
  const auto swing = [](double t_s) {
    const double phase = std::fmod(t_s + 0.4, 3.0);
    return phase < 1.5 ? -90.0 + 120.0 * phase : 90.0 - 120.0 * (phase - 1.5);
  };
  ASSERT_TRUE(watched(10.0, swing).has_value());
  EXPECT_NEAR(*watched(10.0, swing), 1.5, 0.01);
}

TEST(TurnWatchTest, ATurningMotorForHalfATurn) {
  const auto turn = [](double t_s) { return -250.0 * t_s; };
  ASSERT_TRUE(watched(5.0, turn).has_value());
  EXPECT_NEAR(*watched(5.0, turn), 0.72, 0.01);
}

TEST(TurnWatchTest, AMotorThatStandsStillShowsNothing) {
  EXPECT_FALSE(watched(10.0, [](double t_s) { return 0.25 * (t_s > 5.0); }).has_value());
}

/// 90 degrees to either side in a second, from s = 0 on.
double swing_deg(double s) {
  const double phase = std::fmod(s, 2.0);
  return phase < 1.0 ? -90.0 + 180.0 * phase : 90.0 - 180.0 * (phase - 1.0);
}

TEST(TurnWatchTest, AHoleInTheReadingsIsNoTurn) {
  TurnWatch watch;
  for (int i = 0; i < 5000; ++i) {
    const double s = 0.002 * i + (i < 2100 ? 0.0 : 60.3);
    watch.add({kZero + std::llround(1e9 * s), kDegree * swing_deg(s)});
    if (i > 2500) {
      ASSERT_NEAR(watch.turn_s().value_or(0.0), 1.0, 0.01) << s;
    }
  }
}

TEST(TurnWatchTest, AStampThatGoesBackIsNoTurn) {
  TurnWatch watch;
  for (int i = 0; i < 5000; ++i) {
    const double s = 0.002 * i;
    const double stamp_s = s - (i < 2100 ? 0.0 : 3600.0);
    watch.add({kZero + std::llround(1e9 * stamp_s), kDegree * swing_deg(s)});
  }
  EXPECT_NEAR(watch.turn_s().value_or(0.0), 1.0, 0.01);
}

TEST(TurnWatchTest, AMotorThatSlowsDownIsToldWithinThreeTurns) {
  SpinningSweeps sweeps(SpinningConfig{});
  for (int i = 0; i < 500 * 110; ++i) {
    const double s = 0.002 * i;
    const double way_s = s < 100.0 ? s : 100.0 + 0.5 * (s - 100.0);
    sweeps.add(AngleReading{kZero + 2 * kMs * i, kDegree * swing_deg(way_s)});
    if (s > 4.5 && s < 100.0) {
      ASSERT_FALSE(sweeps.other_turn_s().has_value()) << s;
    }
    if (s > 106.5) {
      ASSERT_NEAR(sweeps.other_turn_s().value_or(0.0), 2.0, 0.01) << s;
    }
  }
}

TEST(TurnWatchTest, AMotorThatStopsIsToldUntilItTurnsAgain) {
  SpinningSweeps sweeps(SpinningConfig{});
  for (int i = 0; i < 500 * 12; ++i) {
    const double s = 0.002 * i;
    // Stops in the middle of a swing, for 3 s.
    const double way_s = s < 5.5 ? s : s < 8.5 ? 5.5 : s - 3.0;
    sweeps.add(AngleReading{kZero + 2 * kMs * i, kDegree * swing_deg(way_s)});
    if (s < 5.9 || s > 9.2) {
      ASSERT_FALSE(sweeps.stands()) << s;
    }
    if (s > 7.1 && s < 8.9) {
      ASSERT_TRUE(sweeps.stands()) << s;
    }
  }
}

TEST(TurnWatchTest, AMotorThatNeverTurnsIsTold) {
  SpinningSweeps sweeps(SpinningConfig{});
  for (int i = 0; i < 500 * 3; ++i) sweeps.add(AngleReading{kZero + 2 * kMs * i, 0.1});
  EXPECT_TRUE(sweeps.stands());
}

}  // namespace
}  // namespace zloam::driver::spinning
