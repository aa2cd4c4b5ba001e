// Order, second copies, gaps and giving up, with time as an argument.

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
  /// All that comes out now.
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

// The first sweeps of a run come from several replicas, the later ones first. One replica's answer
// with what it has must not be taken for all there is.
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

TEST(Sequencer, ReplayIsNotBounded) {
  Bench b({.newest = 2}, true);
  for (std::uint64_t sweep = 0; sweep < 20; ++sweep) b.add(sweep);
  EXPECT_EQ(b.out().size(), 20U);
}

TEST(Sequencer, ANewRunFollowsTheOldOneAndNeverGoesBack) {
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
  EXPECT_EQ(b.add(3, 1), Drop::kWrongRun);
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

TEST(Sequencer, ContinuesWhereARestoredStageStands) {
  Bench b({}, true);
  b.sequencer.continue_at(1, 10);
  EXPECT_EQ(b.add(9), Drop::kDuplicate);
  b.add(10);
  EXPECT_EQ(b.out(), Sweeps{10});
}

TEST(SeenNumbers, CountsCopiesPerPublisher) {
  SeenNumbers seen;
  EXPECT_TRUE(seen.add("a", 5, false, 0));
  EXPECT_FALSE(seen.add("a", 5, false, 0));
  EXPECT_TRUE(seen.add("b", 5, false, 0));
  EXPECT_FALSE(seen.deadline());
  EXPECT_TRUE(seen.add("a", 8, false, 0));
  EXPECT_TRUE(seen.add("a", 6, false, 0));
  EXPECT_FALSE(seen.add("a", 6, false, 0));
  EXPECT_FALSE(seen.add("a", 8, false, 0));
  for (std::uint64_t n = 9; n < 100'000; ++n) EXPECT_TRUE(seen.add("a", n, false, 0));
  // 7 went beyond memory
  EXPECT_EQ(seen.lost(), 1U);
  EXPECT_FALSE(seen.add("a", 7, false, 0));
}

TEST(SeenNumbers, LiveAsksForTheGapAndGivesItUp) {
  SeenNumbers seen({.gap_live_ns = 30 * kMs, .late_ns = 200 * kMs});
  EXPECT_TRUE(seen.add("a", 0, false, 0));
  EXPECT_TRUE(seen.add("a", 3, false, 10 * kMs));
  EXPECT_TRUE(seen.add("a", 5, false, 20 * kMs));
  EXPECT_FALSE(seen.request(39 * kMs));
  EXPECT_EQ(seen.deadline(), 40 * kMs);
  const auto first = seen.request(40 * kMs);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->first, 1U);
  EXPECT_EQ(first->last, 2U);
  EXPECT_FALSE(seen.request(99 * kMs));
  EXPECT_TRUE(seen.request(100 * kMs));
  EXPECT_TRUE(seen.add("a", 1, false, 110 * kMs));  // a part of the answer: 2 is a gap of its own
  EXPECT_EQ(seen.lost(), 0U);
  EXPECT_FALSE(seen.request(310 * kMs));  // 2 is given up, 4 is waited for
  EXPECT_EQ(seen.lost(), 1U);
  const auto next = seen.request(340 * kMs);
  ASSERT_TRUE(next);
  EXPECT_EQ(next->first, 4U);
  EXPECT_EQ(next->last, 4U);
  EXPECT_TRUE(seen.add("a", 4, false, 341 * kMs));
  EXPECT_FALSE(seen.deadline());
  EXPECT_FALSE(seen.request(10'000 * kMs));
  EXPECT_EQ(seen.lost(), 1U);
}

TEST(SeenNumbers, ReplayNeverGivesUpAndNamesWhatIsOverdue) {
  SeenNumbers seen({.gap_replay_ns = 200 * kMs, .replay_limit_ns = 120'000 * kMs});
  EXPECT_TRUE(seen.add("a", 0, true, 0));
  EXPECT_TRUE(seen.add("a", 2, true, 0));
  EXPECT_TRUE(seen.request(200 * kMs));
  EXPECT_FALSE(seen.overdue(119'999 * kMs));
  EXPECT_TRUE(seen.request(119'999 * kMs));
  EXPECT_EQ(seen.overdue(120'000 * kMs), 1U);
  EXPECT_EQ(seen.lost(), 0U);
}

}  // namespace
}  // namespace zloam::runtime
