#include "common/runtime/seen_numbers.hpp"

#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;

TEST(SeenNumbers, CountsCopiesPerPublisher) {
  SeenNumbers seen;
  EXPECT_EQ(seen.add("a", 5, false, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 5, false, 0), Drop::kDuplicate);
  EXPECT_EQ(seen.add("b", 5, false, 0), std::nullopt);
  EXPECT_FALSE(seen.deadline());
  EXPECT_EQ(seen.add("a", 8, false, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 6, false, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 6, false, 0), Drop::kDuplicate);
  EXPECT_EQ(seen.add("a", 8, false, 0), Drop::kDuplicate);
  for (std::uint64_t n = 9; n < 100'000; ++n) EXPECT_EQ(seen.add("a", n, false, 0), std::nullopt);
  // Number 7 was given up when the memory was full.
  EXPECT_EQ(seen.lost(), 1U);
  EXPECT_EQ(seen.add("a", 7, false, 0), Drop::kInvalid);
}

TEST(SeenNumbers, OneFarNumberMakesNoTrueOneOld) {
  SeenNumbers seen;
  constexpr std::uint64_t kFar = std::uint64_t{1} << 63;
  for (std::uint64_t n = 0; n < 100; ++n) {
    EXPECT_EQ(seen.add("a", n, false, 0), std::nullopt);
    EXPECT_EQ(seen.add("a", kFar, false, 0), Drop::kInvalid) << n;
  }
  EXPECT_FALSE(seen.deadline());
  EXPECT_EQ(seen.lost(), 0U);
}

TEST(SeenNumbers, APublisherThatBeganAnewIsTakenUpAtItsSecondMessage) {
  SeenNumbers seen;
  EXPECT_EQ(seen.add("a", 1'000'000, false, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 0, false, 0), Drop::kInvalid);
  for (std::uint64_t n = 1; n < 100; ++n) EXPECT_EQ(seen.add("a", n, false, 0), std::nullopt);
  // If that one was a forger's, the true publisher is accepted again at its second message, too.
  EXPECT_EQ(seen.add("a", 1'000'001, false, 0), Drop::kInvalid);
  EXPECT_EQ(seen.add("a", 1'000'002, false, 0), std::nullopt);
}

TEST(SeenNumbers, WhatIsRememberedOfPublishersHasABound) {
  SeenNumbers seen;
  for (int n = 0; n < 10'000; ++n) {
    EXPECT_EQ(seen.add("forged-" + std::to_string(n), 7, false, 0), std::nullopt);
    EXPECT_EQ(seen.add("a", static_cast<std::uint64_t>(n), false, 0), std::nullopt);
    EXPECT_EQ(seen.add("a", static_cast<std::uint64_t>(n), false, 0), Drop::kDuplicate);
  }
  EXPECT_LE(seen.publishers(), 16U);
  EXPECT_GT(seen.forgotten(), 9'000U);
}

TEST(SeenNumbers, LiveAsksForTheGapAndGivesItUp) {
  SeenNumbers seen({.gap_live_ns = 30 * kMs, .late_ns = 200 * kMs});
  EXPECT_EQ(seen.add("a", 0, false, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 3, false, 10 * kMs), std::nullopt);
  EXPECT_EQ(seen.add("a", 5, false, 20 * kMs), std::nullopt);
  EXPECT_FALSE(seen.request(39 * kMs));
  EXPECT_EQ(seen.deadline(), 40 * kMs);
  const auto first = seen.request(40 * kMs);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->first, 1U);
  EXPECT_EQ(first->last, 2U);
  EXPECT_FALSE(seen.request(99 * kMs));
  EXPECT_TRUE(seen.request(100 * kMs));
  EXPECT_EQ(seen.add("a", 1, false, 110 * kMs),
            std::nullopt);  // a part of the answer: 2 is a gap of its own
  EXPECT_EQ(seen.lost(), 0U);
  EXPECT_FALSE(seen.request(310 * kMs));  // 2 is given up, 4 is waited for
  EXPECT_EQ(seen.lost(), 1U);
  const auto next = seen.request(340 * kMs);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->first, 4U);
  EXPECT_EQ(next->last, 4U);
  EXPECT_EQ(seen.add("a", 4, false, 341 * kMs), std::nullopt);
  EXPECT_FALSE(seen.deadline());
  EXPECT_FALSE(seen.request(10'000 * kMs));
  EXPECT_EQ(seen.lost(), 1U);
}

TEST(SeenNumbers, ReplayNeverGivesUpAndNamesWhatIsOverdue) {
  SeenNumbers seen({.gap_replay_ns = 200 * kMs, .replay_limit_ns = 120'000 * kMs});
  EXPECT_EQ(seen.add("a", 0, true, 0), std::nullopt);
  EXPECT_EQ(seen.add("a", 2, true, 0), std::nullopt);
  EXPECT_TRUE(seen.request(200 * kMs));
  EXPECT_FALSE(seen.overdue(119'999 * kMs));
  EXPECT_TRUE(seen.request(119'999 * kMs));
  EXPECT_EQ(seen.overdue(120'000 * kMs), 1U);
  EXPECT_EQ(seen.lost(), 0U);
}

// As of a mapping that was killed in a replay: its readers ended after two minutes, and the gaps of
// its successor were not requested.
TEST(SeenNumbers, WhatAPublisherThatWasReplacedLeftIsGivenUpAfterThreeRequests) {
  SeenNumbers seen({.gap_replay_ns = 200 * kMs, .replay_limit_ns = 120'000 * kMs});
  for (const std::uint64_t n : {0U, 2U}) EXPECT_EQ(seen.add("a/1", n, true, 0), std::nullopt);
  for (const std::uint64_t n : {0U, 3U}) EXPECT_EQ(seen.add("b/2", n, true, 0), std::nullopt);
  for (const std::int64_t at_ms : {200, 600, 1400}) {
    const auto request = seen.request(at_ms * kMs);
    ASSERT_TRUE(request) << at_ms;
    EXPECT_EQ(request->last, 1U) << at_ms;
  }
  EXPECT_FALSE(seen.request(2999 * kMs)) << "the last request may still be answered";
  EXPECT_EQ(seen.lost(), 0U);
  EXPECT_FALSE(seen.request(3000 * kMs));
  EXPECT_EQ(seen.lost(), 1U);
  const auto next = seen.request(3200 * kMs);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->first, 1U);
  EXPECT_EQ(next->last, 2U);
  for (std::int64_t at_ms = 3200; at_ms < 123'000; at_ms += 100) seen.request(at_ms * kMs);
  EXPECT_EQ(seen.lost(), 1U) << "the successor is there, and may still send them";
  EXPECT_EQ(seen.overdue(123'000 * kMs), 1U);
}

// Map tiles: nobody keeps them by number, and whoever wants them all asks for the map.
TEST(SeenNumbers, WhatNobodyAnswersByNumberIsGivenUpInAReplayToo) {
  for (const bool replay : {true, false}) {
    SeenNumbers seen({.by_number = false, .late_ns = 100 * kMs});
    EXPECT_EQ(seen.add("a", 0, replay, 0), std::nullopt);
    EXPECT_EQ(seen.add("a", 3, replay, 0), std::nullopt);
    EXPECT_EQ(seen.deadline(), 100 * kMs);
    EXPECT_FALSE(seen.request(99 * kMs));
    EXPECT_EQ(seen.lost(), 0U);
    EXPECT_FALSE(seen.request(100 * kMs));
    EXPECT_EQ(seen.lost(), 2U);
    EXPECT_FALSE(seen.overdue(1'000'000 * kMs));
    EXPECT_EQ(seen.add("a", 4, replay, 101 * kMs), std::nullopt);
  }
}

}  // namespace
}  // namespace zloam::runtime
