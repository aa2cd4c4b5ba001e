#include "common/runtime/host_clock.hpp"

#include <gtest/gtest.h>

#include <random>

namespace zloam::runtime {
namespace {

constexpr std::int64_t kUs = 1000;

/// A query that takes there_ns to arrive, work_ns to answer and back_ns to return; the other clock
/// is ahead by ahead_ns.
TimeExchange exchange(std::int64_t there_ns, std::int64_t work_ns, std::int64_t back_ns,
                      std::int64_t ahead_ns, std::int64_t at_ns = 1'000'000'000) {
  TimeExchange e;
  e.asked_ns = at_ns;
  e.received_ns = at_ns + there_ns + ahead_ns;
  e.sent_ns = e.received_ns + work_ns;
  e.answered_ns = at_ns + there_ns + work_ns + back_ns;
  return e;
}

TEST(HostClock, KnowsNothingBeforeAnAnswer) { EXPECT_FALSE(HostClock().offset().has_value()); }

TEST(HostClock, EqualWaysGiveTheOffsetExactly) {
  HostClock clock;
  clock.add(exchange(200 * kUs, 50 * kUs, 200 * kUs, -80'000 * kUs));
  EXPECT_EQ(clock.offset()->offset_ns, -80'000 * kUs);
  EXPECT_EQ(clock.offset()->uncertainty_ns, 200 * kUs);
}

TEST(HostClock, TheTruthLiesWithinTheUncertaintyHoweverUnlikeTheWaysAre) {
  std::mt19937_64 random(7);
  std::uniform_int_distribution<std::int64_t> way(0, 30'000 * kUs), ahead(-1'000'000, 1'000'000);
  for (int run = 0; run < 1000; ++run) {
    HostClock clock;
    const std::int64_t truth_ns = ahead(random);
    for (int i = 0; i < 5; ++i)
      clock.add(exchange(way(random), way(random), way(random), truth_ns));
    const ClockOffset found = *clock.offset();
    EXPECT_LE(std::abs(found.offset_ns - truth_ns), found.uncertainty_ns);
  }
}

TEST(HostClock, TheQuickestOfTheLast16Counts) {
  HostClock clock;
  clock.add(exchange(10 * kUs, 0, 10 * kUs, 1000 * kUs));
  for (int i = 0; i < 15; ++i) clock.add(exchange(900 * kUs, 0, 100 * kUs, 2000 * kUs));
  EXPECT_EQ(clock.offset()->offset_ns, 1000 * kUs);
  clock.add(exchange(900 * kUs, 0, 100 * kUs, 2000 * kUs));
  EXPECT_EQ(clock.offset()->offset_ns, 2400 * kUs) << "the quick one is too old";
  EXPECT_EQ(clock.offset()->uncertainty_ns, 500 * kUs);
}

TEST(HostClock, AClockThatWasSetIsKnownAtOnce) {
  HostClock clock;
  for (int i = 0; i < 16; ++i) clock.add(exchange(10 * kUs, 0, 10 * kUs, 0));
  clock.add(exchange(900 * kUs, 0, 900 * kUs, 3'600'000'000 * kUs));
  EXPECT_EQ(clock.offset()->offset_ns, 3'600'000'000 * kUs);
  clock.add(exchange(10 * kUs, 0, 10 * kUs, 0));
  EXPECT_EQ(clock.offset()->offset_ns, 0);
}

TEST(HostClock, AnAnswerBeforeItsQuestionIsIgnored) {
  HostClock clock;
  TimeExchange set_back = exchange(10 * kUs, 0, 10 * kUs, 0);
  set_back.answered_ns = set_back.asked_ns - 1;
  clock.add(set_back);
  EXPECT_FALSE(clock.offset().has_value());
}

}  // namespace
}  // namespace zloam::runtime
