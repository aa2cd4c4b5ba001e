// Order, duplicates, gaps and giving up; time is an argument.

#include "common/runtime/sequencer.hpp"

#include <gtest/gtest.h>

#include "common/runtime/tests/sequencer_bench.hpp"

namespace zloam::runtime {
namespace {

using test::Bench;
using test::kMs;
using test::message;
using test::Sweeps;

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

// Of two replicas, or because a link is slow: they wait until the run before has been handed out.
TEST(Sequencer, SecondCopiesOfANewRunAreCountedWhenItBegins) {
  Bench b({}, true);
  EXPECT_EQ(b.add(0, 1), std::nullopt);
  for (const std::uint64_t sweep : {0U, 1U, 0U, 5'000U}) EXPECT_EQ(b.add(sweep, 2), std::nullopt);
  EXPECT_TRUE(b.sequencer.refused().empty());
  EXPECT_EQ(b.out(), (Sweeps{0, 0, 1}));
  EXPECT_EQ(b.sequencer.refused(), (std::vector<Drop>{Drop::kDuplicate, Drop::kInvalid}));
  EXPECT_EQ(b.sequencer.held(), 0U);
  EXPECT_TRUE(b.sequencer.refused().empty());
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

/// Adds a replay's message, and returns after how many requests without an answer it is handed out;
/// 0: not after ten.
int requests_until_out(Sequencer& s, const test::Spec& spec) {
  std::int64_t now = 0;
  s.add(message(spec), now);
  for (int requests = 0; requests <= 10; ++requests) {
    if (s.next(now)) return requests;
    now += 10'000 * kMs;
    const auto request = s.request(now);
    if (!request) return 0;
    s.answered(*request, 0);
  }
  return 0;
}

// Mapping is killed in a replay: its submaps end at sweep 5, its successor's begin at 20.
TEST(Sequencer, ReplayGoesOnWithTheFirstMessageOfASuccessorThatLeavesSweepsOut) {
  const test::Spec last{.sweep = 5, .seq = 1, .replay = true};
  for (const char* name : {"a", "b"}) {
    for (const bool sparse : {true, false}) {
      Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = sparse});
      s.add(message({.sweep = 0, .replay = true}), 0);
      s.add(message(last), 0);
      EXPECT_EQ(s.next(0)->header->sweep(), 0U);
      EXPECT_EQ(s.next(0)->header->sweep(), 5U);
      const test::Spec next{.sweep = 20, .seq = 0, .replay = true, .instance = name};
      EXPECT_EQ(requests_until_out(s, next), sparse ? 3 : 0);
      EXPECT_TRUE(s.given_up().empty());
    }
  }
}

// A submap comes for about forty sweeps.
TEST(Sequencer, OfSparseMessagesThoseThatWereSentCountAsLost) {
  Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = true});
  std::int64_t now = 1'000 * kMs;
  const auto lost_before = [&](std::uint64_t sweep, std::uint64_t seq, const char* instance) {
    now += 20'000 * kMs;
    EXPECT_EQ(s.add(message({.sweep = sweep, .seq = seq, .instance = instance}), now),
              std::nullopt);
    now += 1'000 * kMs;
    EXPECT_TRUE(s.next(now));
    return s.given_up().size();
  };
  EXPECT_EQ(lost_before(40, 0, "a"), 0U);
  EXPECT_EQ(lost_before(80, 1, "a"), 0U);
  EXPECT_EQ(lost_before(160, 3, "a"), 1U);
  EXPECT_EQ(lost_before(240, 0, "b"), 0U);
  EXPECT_EQ(lost_before(320, 2, "c"), 2U);
  EXPECT_EQ(s.add(message({.sweep = 120, .seq = 2, .instance = "a"}), now), Drop::kLate);
}

TEST(Sequencer, ReplayWaitsForWhatASuccessorSentBefore) {
  Sequencer s({.sweeps = SweepSet::kPublisherDecides, .sparse = true});
  s.add(message({.sweep = 0, .replay = true}), 0);
  EXPECT_TRUE(s.next(0));
  EXPECT_EQ(requests_until_out(s, {.sweep = 20, .seq = 1, .replay = true, .instance = "b"}), 0);
}

TEST(Sequencer, ContinuesWhereARestoredStageStands) {
  Bench b({}, true);
  b.sequencer.continue_at(1, 10);
  EXPECT_EQ(b.add(9), Drop::kDuplicate);
  b.add(10);
  EXPECT_EQ(b.out(), Sweeps{10});
}

TEST(Sequencer, NamesTheWaitingMessagesThatAContinuationLeavesOut) {
  Bench b({}, true);
  for (const std::uint64_t sweep : {2U, 3U, 5U}) b.add(sweep);
  const auto below = b.sequencer.continue_at(1, 4);
  ASSERT_EQ(below.size(), 2U);
  EXPECT_EQ(below[0].header->sweep(), 2U);
  EXPECT_EQ(below[1].header->sweep(), 3U);
  EXPECT_EQ(b.sequencer.held(), 1U);
  // Sweep 5 of the run before must not pass for that of the next.
  const auto before = b.sequencer.continue_at(2, 4);
  ASSERT_EQ(before.size(), 1U);
  EXPECT_EQ(before[0].header->run(), 1U);
  for (const std::uint64_t sweep : {5U, 4U}) EXPECT_EQ(b.add(sweep, 2), std::nullopt);
  EXPECT_EQ(b.out(), (Sweeps{4, 5}));
}

}  // namespace
}  // namespace zloam::runtime
