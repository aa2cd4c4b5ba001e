// Order, duplicates, gaps and giving up; time is an argument.

#include "common/runtime/sequencer.hpp"

#include <gtest/gtest.h>

#include "common/messages/build.hpp"
#include "common/runtime/seen_numbers.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;

struct Spec {
  std::uint64_t run = 1;
  std::uint64_t sweep = 0;
  std::uint64_t seq = 0;
  bool replay = false;
  std::string instance = "a";
  std::int64_t period_ns = 100 * kMs;
};

Message message(const Spec& s) {
  HeaderFields h;
  h.robot = "r";
  h.frame = "lidar";
  h.run = s.run;
  h.sweep = s.sweep;
  h.seq = s.seq;
  h.replay = s.replay;
  h.instance = s.instance;
  h.stamp_ns = static_cast<std::int64_t>(s.sweep) * s.period_ns;
  auto buffer = std::make_shared<Buffer>(build(h, SweepFields{}));
  Message m;
  m.bytes = {buffer->data(), buffer->size()};
  m.header = message_of<msg::Sweep>(m.bytes).header();
  m.owner = buffer;
  return m;
}

struct Bench {
  explicit Bench(SequencerLimits limits = {}, bool is_replay = false)
      : sequencer(limits), replay(is_replay) {}
  std::optional<Drop> add(std::uint64_t sweep, std::uint64_t run = 1) {
    return sequencer.add(message({.run = run, .sweep = sweep, .seq = sweep, .replay = replay}),
                         now);
  }
  /// All sweeps that are handed out now.
  std::vector<std::uint64_t> out() {
    std::vector<std::uint64_t> sweeps;
    while (const auto m = sequencer.next(now)) sweeps.push_back(m->header->sweep());
    return sweeps;
  }
  Sequencer sequencer;
  bool replay;
  std::int64_t now = 1'000'000'000;
};

using Sweeps = std::vector<std::uint64_t>;

TEST(Sequencer, AscendingOrderWhateverTheOrderOfArrival) {
  Bench b({}, true);
  for (const std::uint64_t sweep : {2U, 0U, 3U, 1U}) EXPECT_EQ(b.add(sweep), std::nullopt);
  EXPECT_EQ(b.out(), (Sweeps{0, 1, 2, 3}));
}

TEST(Sequencer, WhatIsTakenBackIsMissingAgain) {
  Bench b({}, true);
  for (const std::uint64_t sweep : {1U, 2U, 3U}) EXPECT_EQ(b.add(sweep), std::nullopt);
  b.sequencer.remove_if([](const Message& m) { return m.header->sweep() == 2; }, b.now);
  EXPECT_EQ(b.sequencer.arrivals().missing, (Sweeps{0, 2}));
  EXPECT_EQ(b.add(0), std::nullopt);
  EXPECT_EQ(b.out(), (Sweeps{0, 1}));
  EXPECT_EQ(b.add(2), std::nullopt);
  EXPECT_EQ(b.out(), (Sweeps{2, 3}));
}

TEST(Sequencer, IdentityIsAcceptedOnce) {
  Bench b({}, true);
  EXPECT_EQ(b.add(0), std::nullopt);
  EXPECT_EQ(b.add(0), Drop::kDuplicate);
  EXPECT_EQ(b.out(), Sweeps{0});
  EXPECT_EQ(b.add(0), Drop::kDuplicate);
  EXPECT_EQ(b.add(2), std::nullopt);
  EXPECT_EQ(b.add(2), Drop::kDuplicate);
}

TEST(Sequencer, SaysWhatHasComeAndWhatIsMissing) {
  Bench b({}, true);
  for (const std::uint64_t sweep : {0U, 1U, 3U, 6U}) b.add(sweep);
  EXPECT_EQ(b.out(), (Sweeps{0, 1}));
  EXPECT_EQ(b.sequencer.arrivals().missing, (Sweeps{2, 4, 5}));
  EXPECT_EQ(b.sequencer.arrivals().received_below, 7U);
  for (const std::uint64_t sweep : {2U, 4U, 5U}) b.add(sweep);
  EXPECT_EQ(b.out(), (Sweeps{2, 3, 4, 5, 6}));
  EXPECT_TRUE(b.sequencer.arrivals().missing.empty());
  EXPECT_EQ(b.sequencer.arrivals().received_below, 7U);
}

// The first sweeps of a run come from several replicas, the later ones first. The answer of one
// replica contains its own sweeps only and must not be taken for all there are.
TEST(Sequencer, OneReplicasAnswerDoesNotTellWhereAReplayBegins) {
  for (const bool replicas : {true, false}) {
    Bench b({.replicas = replicas}, true);
    b.add(2);
    b.now += 200 * kMs;
    const auto request = b.sequencer.request(b.now);
    ASSERT_TRUE(request);
    EXPECT_EQ(request->first, 0U);
    b.add(1);
    b.sequencer.answered(*request, 1);
    EXPECT_EQ(b.out(), replicas ? Sweeps{} : (Sweeps{1, 2}));
    b.add(0);
    EXPECT_EQ(b.out(), replicas ? (Sweeps{0, 1, 2}) : Sweeps{});
  }
}

TEST(Sequencer, LiveAsksAfterTheGapTimeAndGivesUpAfterOnePeriod) {
  Bench b;
  b.add(5);
  b.add(6);
  EXPECT_EQ(b.out(), (Sweeps{5, 6}));  // live begins where it is joined
  b.add(8);
  EXPECT_EQ(b.out(), Sweeps{});
  EXPECT_FALSE(b.sequencer.request(b.now + 29 * kMs));
  b.now += 30 * kMs;
  const auto request = b.sequencer.request(b.now);
  ASSERT_TRUE(request);
  EXPECT_EQ(request->first, 7U);
  EXPECT_EQ(request->last, 7U);
  EXPECT_FALSE(b.sequencer.request(b.now + 59 * kMs));  // the wait has doubled
  EXPECT_TRUE(b.sequencer.request(b.now + 60 * kMs));
  b.now += 69 * kMs;
  EXPECT_EQ(b.out(), Sweeps{});
  b.now += 1 * kMs;  // 100 ms after the gap was seen
  EXPECT_EQ(b.out(), Sweeps{8});
  const auto lost = b.sequencer.given_up();
  ASSERT_EQ(lost.size(), 1U);
  EXPECT_EQ(lost[0].sweep, 7U);
  EXPECT_FALSE(lost[0].drop);
  EXPECT_EQ(b.add(7), Drop::kLate);
  EXPECT_EQ(b.add(6), Drop::kDuplicate);
}

TEST(Sequencer, LivePeriodIsMeasured) {
  Sequencer s({});
  const auto add = [&](std::uint64_t sweep, std::int64_t now) {
    return s.add(message({.sweep = sweep, .seq = sweep, .period_ns = 1000 * kMs}), now);
  };
  add(0, 0);
  add(1, 0);
  while (s.next(0)) {
  }
  add(3, 0);
  EXPECT_FALSE(s.next(999 * kMs));
  EXPECT_TRUE(s.next(1000 * kMs));
}

TEST(Sequencer, AGapThatFillsIsNoLoss) {
  Bench b({}, true);
  b.add(0);
  b.add(2);
  EXPECT_EQ(b.out(), Sweeps{0});
  b.now += 200 * kMs;
  EXPECT_TRUE(b.sequencer.request(b.now));
  b.add(1);
  EXPECT_EQ(b.out(), (Sweeps{1, 2}));
  EXPECT_TRUE(b.sequencer.given_up().empty());
  EXPECT_FALSE(b.sequencer.deadline());
}

TEST(Sequencer, ReplayNeverGivesUpAndNamesWhatIsOverdue) {
  Bench b({}, true);
  b.add(0);
  EXPECT_EQ(b.out(), Sweeps{0});
  b.add(2);
  b.now += 119'000 * kMs;
  EXPECT_EQ(b.out(), Sweeps{});
  EXPECT_FALSE(b.sequencer.overdue(b.now));
  b.now += 1'000 * kMs;
  EXPECT_EQ(b.sequencer.overdue(b.now), 1U);
  EXPECT_EQ(b.out(), Sweeps{});
}

TEST(Sequencer, ReplayBeginsAtZeroOrWhereThePublisherStillIs) {
  Bench b({}, true);
  b.add(40);
  EXPECT_EQ(b.out(), Sweeps{});
  b.now += 200 * kMs;
  const auto request = b.sequencer.request(b.now);
  ASSERT_TRUE(request);
  EXPECT_EQ(request->first, 0U);
  EXPECT_EQ(request->last, 39U);
  for (std::uint64_t sweep = 30; sweep < 40; ++sweep) b.add(sweep);
  b.sequencer.answered(*request, 10);
  EXPECT_EQ(b.out().front(), 30U);
  EXPECT_TRUE(b.sequencer.given_up().empty());
}

TEST(Sequencer, ReplayWithTheFirstSweepLostWaitsForIt) {
  Bench b({}, true);
  b.add(1);
  b.now += 200 * kMs;
  const auto request = b.sequencer.request(b.now);
  ASSERT_TRUE(request);
  b.sequencer.answered(*request, 0);  // nobody answered: not a reason to begin at 1
  EXPECT_EQ(b.out(), Sweeps{});
  b.add(0);
  EXPECT_EQ(b.out(), (Sweeps{0, 1}));
}

// The first messages of a run may be lost before their link is up on both sides.
TEST(Sequencer, LiveAsksForTheFirstSweepsOfARunThatHasJustBegun) {
  Bench b;
  b.add(2);
  EXPECT_EQ(b.out(), Sweeps{});
  b.now += 40 * kMs;
  const auto request = b.sequencer.request(b.now);
  ASSERT_TRUE(request);
  EXPECT_EQ(request->first, 0U);
  EXPECT_EQ(request->last, 1U);
  b.add(0);
  b.add(1);
  EXPECT_EQ(b.out(), (Sweeps{0, 1, 2}));
  EXPECT_TRUE(b.sequencer.given_up().empty());
}

TEST(Sequencer, LiveBeginsWhereItIsJoinedWhenNobodyHasWhatWasBefore) {
  Bench b;
  b.add(1);
  b.now += 1000 * kMs;
  EXPECT_EQ(b.out(), Sweeps{1});
  EXPECT_TRUE(b.sequencer.given_up().empty());
}

TEST(Sequencer, LiveBoundDropsTheOldestAndSaysSo) {
  Bench b({.newest = 4});
  for (std::uint64_t sweep = 0; sweep < 7; ++sweep) EXPECT_EQ(b.add(sweep), std::nullopt);
  const auto dropped = b.sequencer.given_up();
  ASSERT_EQ(dropped.size(), 3U);
  for (std::uint64_t i = 0; i < 3; ++i) {
    EXPECT_EQ(dropped[i].sweep, i);
    EXPECT_EQ(dropped[i].drop, Drop::kQueueFull);
  }
  EXPECT_EQ(b.out(), (Sweeps{3, 4, 5, 6}));
  EXPECT_EQ(b.add(1), Drop::kLate);
}

TEST(Sequencer, WhatCameWhileItsReaderRestoredItselfIsNotDropped) {
  Bench b({.newest = 2});
  EXPECT_EQ(b.add(10), std::nullopt);
  EXPECT_EQ(b.out(), Sweeps{10});
  b.sequencer.continue_at(1, 13);
  b.sequencer.make_room(6);
  for (std::uint64_t sweep = 11; sweep < 17; ++sweep) b.add(sweep);
  EXPECT_EQ(b.sequencer.next(b.now)->header->sweep(), 13U);
  // Sweeps that arrive meanwhile have the usual room.
  for (std::uint64_t sweep = 17; sweep < 19; ++sweep) b.add(sweep);
  EXPECT_EQ(b.out(), (Sweeps{14, 15, 16, 17, 18}));
  EXPECT_TRUE(b.sequencer.given_up().empty());
  // The usual bound applies again after the extra sweeps were handed out.
  for (std::uint64_t sweep = 19; sweep < 22; ++sweep) b.add(sweep);
  EXPECT_EQ(b.out(), (Sweeps{20, 21}));
}

TEST(Sequencer, ABacklogThatIsNotWorkedOffGoes) {
  Bench b({.newest = 2});
  b.sequencer.continue_at(1, 0);
  b.sequencer.make_room(10);
  std::size_t most = 0;
  for (std::uint64_t sweep = 0; sweep < 30; ++sweep) {
    b.add(sweep);
    most = std::max(most, b.sequencer.held());
  }
  EXPECT_EQ(most, 12U);
  EXPECT_EQ(b.out(), (Sweeps{28, 29}));
}

TEST(Sequencer, ReplayIsNotBounded) {
  Bench b({.newest = 2}, true);
  for (std::uint64_t sweep = 0; sweep < 20; ++sweep) b.add(sweep);
  EXPECT_EQ(b.out().size(), 20U);
}

TEST(Sequencer, ANewRunFollowsTheOldOne) {
  Bench b({}, true);
  b.add(0, 1);
  b.add(1, 1);
  b.add(0, 2);
  b.add(2, 1);
  b.add(1, 2);
  std::vector<std::pair<std::uint64_t, std::uint64_t>> out;
  while (const auto m = b.sequencer.next(b.now)) {
    out.emplace_back(m->header->run(), m->header->sweep());
  }
  const std::vector<std::pair<std::uint64_t, std::uint64_t>> expected = {
      {1, 0}, {1, 1}, {1, 2}, {2, 0}, {2, 1}};
  EXPECT_EQ(out, expected);
  EXPECT_EQ(b.add(2, 2), std::nullopt);
}

TEST(Sequencer, PublisherMayLeaveSweepsOut) {
  Sequencer s({.sweeps = SweepSet::kPublisherDecides});
  const auto add = [&](std::uint64_t sweep, std::uint64_t seq, const std::string& instance) {
    return s.add(message({.sweep = sweep, .seq = seq, .replay = true, .instance = instance}), 0);
  };
  add(0, 0, "a");
  add(5, 1, "a");
  add(10, 2, "a");
  Sweeps out;
  while (const auto m = s.next(0)) out.push_back(m->header->sweep());
  EXPECT_EQ(out, (Sweeps{0, 5, 10}));
  add(20, 4, "a");  // number 3 is missing
  EXPECT_FALSE(s.next(0));
  EXPECT_EQ(s.request(200 * kMs)->first, 11U);
  add(15, 3, "a");
  EXPECT_EQ(s.next(0)->header->sweep(), 15U);
  EXPECT_EQ(s.next(0)->header->sweep(), 20U);
  add(25, 5, "b");  // another publisher's number says nothing
  EXPECT_FALSE(s.next(0));
}

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

TEST(Sequencer, ContinuesWhereARestoredStageStands) {
  Bench b({}, true);
  b.sequencer.continue_at(1, 10);
  EXPECT_EQ(b.add(9), Drop::kDuplicate);
  b.add(10);
  EXPECT_EQ(b.out(), Sweeps{10});
}

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

}  // namespace
}  // namespace zloam::runtime
