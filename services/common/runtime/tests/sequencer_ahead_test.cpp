// Numbers that are ahead of the time: which are refused, and which are accepted after an outage.

#include <gtest/gtest.h>

#include <vector>

#include "common/runtime/sequencer.hpp"
#include "common/runtime/tests/sequencer_bench.hpp"

namespace zloam::runtime {
namespace {

using test::Bench;
using test::kMs;
using test::Sweeps;

TEST(Sequencer, AbsurdNumbersAreRefused) {
  Bench b({}, true);
  b.add(0);
  EXPECT_EQ(b.add(5'000'000'000), Drop::kInvalid);
  EXPECT_EQ(b.out(), Sweeps{0});
}

TEST(Sequencer, AReplayIsAheadByItsWindowAndNotMore) {
  Bench b({}, true);
  b.add(0);
  EXPECT_EQ(b.out(), Sweeps{0});
  EXPECT_EQ(b.add(900'000), Drop::kInvalid);
  EXPECT_EQ(b.add(1'000), std::nullopt);
  // When a replay is joined in the middle, its first messages show where it stands.
  Bench joined({}, true);
  EXPECT_EQ(joined.add(900'000), std::nullopt);
  EXPECT_EQ(joined.add(899'990), std::nullopt);
  EXPECT_EQ(joined.add(2'000'000), Drop::kInvalid);
}

// A robot stands for two minutes in a recording: there is no submap of that time.
TEST(Sequencer, AReplaysSparseMessagesMayBeFarApart) {
  for (const bool sparse : {true, false}) {
    Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = sparse});
    const auto add = [&s](std::uint64_t sweep, std::uint64_t seq) {
      return s.add(test::message({.sweep = sweep, .seq = seq, .replay = true}), 0);
    };
    EXPECT_EQ(add(60, 0), std::nullopt);
    EXPECT_TRUE(s.next(0));
    EXPECT_EQ(add(1'300, 1), sparse ? std::nullopt : std::optional(Drop::kInvalid));
    EXPECT_EQ(s.next(0).has_value(), sparse);
    EXPECT_EQ(add(5'000'000'000, 2), Drop::kInvalid);
  }
}

/// Ten sweeps a second, all handled.
std::uint64_t drive(Bench& b, std::uint64_t from, std::uint64_t sweeps) {
  for (std::uint64_t n = from; n < from + sweeps; ++n) {
    EXPECT_EQ(b.add(n), std::nullopt) << n;
    EXPECT_EQ(b.out(), Sweeps{n});
    b.now += 100 * kMs;
  }
  return from + sweeps;
}

TEST(Sequencer, ANumberFarAheadIsRefusedAndTheTrueOnesGoOn) {
  Bench b;
  std::uint64_t next = drive(b, 0, 50);
  for (const std::uint64_t far : {std::uint64_t{900'000}, std::uint64_t{20}, ~std::uint64_t{200}}) {
    EXPECT_EQ(b.add(next + far), Drop::kInvalid) << far;
    next = drive(b, next, 20);
  }
  EXPECT_TRUE(b.sequencer.given_up().empty());
}

TEST(Sequencer, AFloodOfNumbersTakesNoMoreThanAHandful) {
  Bench b;
  const std::uint64_t next = drive(b, 0, 50);
  std::uint64_t frontier = next;
  for (int i = 0; i < 5'000; ++i) {
    if (!b.add(frontier + 5)) frontier += 6;
    b.out();
    b.now += kMs / 5;
  }
  // Numbers allowed in this second: the ten of its period, and the allowance for late messages.
  EXPECT_LE(frontier, next + 20);
  b.now += 1'000 * kMs;
  drive(b, frontier, 20);
}

TEST(Sequencer, NeitherDoesAFloodAtTheStartOfWhichNoPeriodCanBeMeasured) {
  Sequencer s({.sparse = true});
  std::int64_t now = 1'000 * kMs;
  std::uint64_t frontier = 0;
  for (int i = 0; i < 100; ++i) {
    if (!s.add(test::message({.sweep = frontier + 5, .period_ns = 0}), now)) frontier += 6;
    s.next(now);
    now += kMs;
  }
  EXPECT_LE(frontier, 40U);
}

// A source may publish faster than its stamps say, as a test or a recording does.
TEST(Sequencer, TheNextNumberIsNeverTooSoon) {
  Bench b;
  for (std::uint64_t n = 0; n < 1'000; ++n) {
    EXPECT_EQ(b.add(n), std::nullopt) << n;
    EXPECT_EQ(b.out(), Sweeps{n});
  }
  EXPECT_EQ(b.add(2'000), Drop::kInvalid);
}

TEST(Sequencer, AfterAnOutageTheNumbersOfItsTimeAreLost) {
  Bench b;
  const std::uint64_t next = drive(b, 0, 50);
  b.now += 60'000 * kMs;
  EXPECT_EQ(b.add(next + 600), std::nullopt);
  b.now += 100 * kMs;
  EXPECT_EQ(b.out(), Sweeps{next + 600});
  EXPECT_EQ(b.sequencer.given_up().size(), 600U);
}

// After a stall a stage publishes its backlog in a burst, of which the transport may lose a part.
TEST(Sequencer, ABurstAfterAStallMayHaveAHoleAtItsEnd) {
  for (const std::uint64_t held_up : {10U, 50U, 200U}) {
    Bench b;
    std::uint64_t next = drive(b, 0, 50);
    b.now += static_cast<std::int64_t>(held_up) * 100 * kMs;
    const std::uint64_t end = next + held_up;
    for (; next < end; ++next) {
      b.now += kMs;
      if (next == end - 3) continue;
      EXPECT_EQ(b.add(next), std::nullopt) << next << " of " << end;
    }
    // The missing sweep is waited for, then given up.
    b.out();
    b.now += 100 * kMs;
    b.out();
    drive(b, next, 20);
  }
}

// Submaps come every few seconds, of a sensor that is faster than the period that is assumed before
// it is measured.
TEST(Sequencer, AFastSensorsMessagesOfSomeSweepsOnlyAreInReach) {
  for (const std::uint64_t hertz : {10U, 20U, 50U}) {
    Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = true});
    std::int64_t now = 1'000 * kMs;
    const std::int64_t period_ns = 1'000 * kMs / static_cast<std::int64_t>(hertz);
    const auto add = [&](std::uint64_t sweep, std::uint64_t seq) {
      return s.add(test::message({.sweep = sweep, .seq = seq, .period_ns = period_ns}), now);
    };
    std::uint64_t sweep = 5;
    for (std::uint64_t seq = 0; seq < 20; ++seq) {
      EXPECT_EQ(add(sweep, seq), std::nullopt) << sweep << " at " << hertz << " Hz";
      EXPECT_TRUE(s.next(now));
      sweep += 3 * hertz;
      now += 3'000 * kMs;
    }
    EXPECT_EQ(add(sweep + 1'000, 20), Drop::kInvalid);
  }
}

// The sensor finds its time source between the first two submaps: by their stamps a sweep lasts
// 1.6 s.
TEST(Sequencer, SparseMessagesGoOnAfterAStepOfTheSensorsClock) {
  Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = true});
  std::vector<std::uint64_t> refused;
  for (std::uint64_t seq = 0; seq < 20; ++seq) {
    const std::uint64_t sweep = 40 * (seq + 1);
    const auto sweeps = static_cast<std::int64_t>(sweep);
    const std::int64_t now = 1'000 * kMs + sweeps * 100 * kMs;
    const std::int64_t stamp_ns = sweeps * 100 * kMs + (seq > 0 ? 60'000 * kMs : 0);
    if (s.add(test::message({.sweep = sweep, .seq = seq, .period_ns = stamp_ns / sweeps}), now)) {
      refused.push_back(seq);
    } else {
      EXPECT_TRUE(s.next(now)) << seq;
    }
  }
  EXPECT_EQ(refused, (std::vector<std::uint64_t>{2, 3}));
}

// A link that stalled and then lost a part of the delayed messages.
TEST(Sequencer, WhatWasHeldUpMayHaveHoles) {
  Bench b;
  std::uint64_t next = drive(b, 0, 50);
  b.now += 3'000 * kMs;
  EXPECT_EQ(b.add(next), std::nullopt);
  EXPECT_EQ(b.out(), Sweeps{next});
  EXPECT_EQ(b.add(next + 25), std::nullopt);
  b.now += 100 * kMs;
  EXPECT_EQ(b.out(), Sweeps{next + 25});
  drive(b, next + 26, 20);
}

// This machine was suspended together with its clock; the driver's machine was not.
TEST(Sequencer, FarNumbersAreTakenUpWhenNothingElseComes) {
  Bench b;
  std::uint64_t next = drive(b, 0, 50) + 5'000;
  int refused = 0;
  while (b.add(next)) {
    ++refused;
    ++next;
    b.now += 100 * kMs;
    ASSERT_LT(refused, 40);
  }
  EXPECT_GE(refused, 15);
  EXPECT_EQ(b.out(), Sweeps{next});
  b.now += 100 * kMs;
  drive(b, next + 1, 20);
}

}  // namespace
}  // namespace zloam::runtime
