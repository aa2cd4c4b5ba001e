// A live input that nobody sends any more although its messages are published: it goes on by
// number, and stops requesting when messages are sent again.

#include <gtest/gtest.h>

#include <chrono>
#include <future>
#include <thread>

#include "common/runtime/tests/sequencer_bench.hpp"
#include "common/runtime/tests/support.hpp"

namespace zloam::runtime {
namespace {

using test::kKeys;
using test::kPatience;
using test::Network;
using test::RunningStage;
using test::setup;
using test::sweep_header;
using test::wait_for_reader;
using test::Watched;

/// One input; messages are sent to it, or arrive as answers.
class Input {
 public:
  explicit Input(bool replay = false) : replay_(replay) {}

  std::optional<Drop> add(std::uint64_t sweep, bool recovered) {
    Message m = test::message({.sweep = sweep, .seq = sweep, .replay = replay_});
    m.recovered = recovered;
    return sequencer.add(std::move(m), now_ns);
  }
  void handle() {
    while (sequencer.next(now_ns)) ++handled;
  }
  void sent(std::uint64_t sweep) {
    add(sweep, false);
    handle();
  }
  void answered(std::uint64_t sweep) {
    EXPECT_EQ(add(sweep, true), std::nullopt) << sweep;
    handle();
  }
  /// The requests of the time to come, as the worker's loop would make them.
  std::vector<Sequencer::Request> requests_within(std::int64_t ns, bool goes_on = true) {
    std::vector<Sequencer::Request> all;
    for (const std::int64_t end_ns = now_ns + ns; now_ns < end_ns; now_ns += 10 * kMs) {
      if (const auto request = sequencer.request(now_ns, goes_on)) all.push_back(*request);
    }
    return all;
  }

  Sequencer sequencer{SequencerLimits{}};
  std::int64_t now_ns = 5000 * kMs;
  int handled = 0;

 private:
  bool replay_;
};

TEST(Silence, WhatFollowsIsRequestedSoonAndThenMoreSeldom) {
  Input input;
  for (std::uint64_t sweep = 0; sweep < 3; ++sweep) input.sent(sweep);
  EXPECT_TRUE(input.requests_within(1900 * kMs).empty());
  const auto first = input.requests_within(200 * kMs);
  ASSERT_GE(first.size(), 1U);
  EXPECT_EQ(first[0].run, 1U);
  EXPECT_EQ(first[0].first, 3U);
  EXPECT_GT(first[0].last, 1000U);
  input.requests_within(60'000 * kMs);
  const std::size_t in_a_minute = input.requests_within(60'000 * kMs).size();
  EXPECT_GE(in_a_minute, 5U);
  EXPECT_LE(in_a_minute, 12U);
}

TEST(Silence, WithAnswersTheInputGoesOnAtTheSensorsPace) {
  Input input;
  for (std::uint64_t sweep = 0; sweep < 3; ++sweep) input.sent(sweep);
  input.requests_within(2010 * kMs);
  for (std::uint64_t sweep = 3; sweep < 23; ++sweep) input.answered(sweep);
  EXPECT_EQ(input.handled, 23);
  for (std::uint64_t sweep = 23; sweep < 43; ++sweep) {
    const auto requests = input.requests_within(150 * kMs);
    ASSERT_GE(requests.size(), 1U) << sweep;
    EXPECT_EQ(requests[0].first, sweep);
    input.answered(sweep);
  }
  EXPECT_EQ(input.handled, 43);
}

TEST(Silence, ABatchOfAnswersIsNotDroppedAsTooMuch) {
  Input input;
  input.sent(0);
  input.requests_within(2010 * kMs);
  // They are read from the transport's queue together, before the first is handled.
  for (std::uint64_t sweep = 1; sweep < 31; ++sweep) {
    EXPECT_EQ(input.add(sweep, true), std::nullopt) << sweep;
  }
  input.handle();
  EXPECT_EQ(input.handled, 31);
  EXPECT_TRUE(input.sequencer.given_up().empty());
}

TEST(Silence, AReaderThatIsTooSlowDropsTheOldestAsOtherwise) {
  Input input;
  input.sent(0);
  input.requests_within(2010 * kMs);
  for (std::uint64_t sweep = 1; sweep < 300; ++sweep) {
    EXPECT_EQ(input.add(sweep, true), std::nullopt) << sweep;
    if (sweep % 2 == 0 && input.sequencer.next(input.now_ns)) ++input.handled;
    input.requests_within(100 * kMs);
  }
  EXPECT_LE(input.sequencer.held(), SequencerLimits{}.newest + 1);
  EXPECT_FALSE(input.sequencer.given_up().empty());
}

TEST(Silence, ItEndsWithTheFirstMessageThatIsSent) {
  for (const bool copy : {false, true}) {
    Input input;
    input.sent(0);
    input.requests_within(2010 * kMs);
    input.answered(1);
    input.sent(copy ? 1 : 2);
    EXPECT_TRUE(input.requests_within(1900 * kMs).empty()) << copy;
  }
}

TEST(Silence, NothingIsRequestedAfterTheEndOrInAReplay) {
  Input ended;
  ended.sent(0);
  EXPECT_TRUE(ended.requests_within(20'000 * kMs, false).empty());
  EXPECT_EQ(ended.sequencer.deadline(), std::nullopt);
  Input replay(true);
  replay.sent(0);
  EXPECT_TRUE(replay.requests_within(20'000 * kMs).empty());
  EXPECT_TRUE(Input().requests_within(20'000 * kMs).empty());  // of which run?
}

// The reader loses all that is sent to it, as if its declaration had not arrived.
TEST(Silence, AStageThatNothingIsSentToWorksByNumber) {
  constexpr std::uint64_t kSweeps = 40;
  const Network network(2);
  Watched<std::vector<std::uint64_t>> seen;
  RunningStage reader(network.open(0), setup("registration", "i", 1), [&](Stage& core) {
    core.inlet<msg::Sweep>(Key::kSweep, {},
                           [&](const Received<msg::Sweep>& sweep) {
                             seen.change([&](auto& list) { list.push_back(sweep.sweep()); });
                           })
        .continue_at(1, 0);
  });
  StageSetup source = setup("driver");
  source.shared.recovery.keep_messages = kSweeps;
  RunningStage driver(network.open(1), std::move(source), [&](Stage& core) {
    Outlet& out = core.outlet(Key::kSweep);
    auto next = std::make_shared<std::uint64_t>(0);
    core.every(std::chrono::milliseconds(50), [&out, next] {
      if (*next == kSweeps) return;
      HeaderFields h = sweep_header(1, *next, false);
      h.stamp_ns = static_cast<std::int64_t>(*next) * 50'000'000;
      h.seq = out.header(0, 0).seq;
      h.end_of_run = ++*next == kSweeps;
      out.publish(h, build(h, SweepFields{.rings = 16}));
    });
  });
  EXPECT_TRUE(seen.wait([](const auto& list) { return list.size() == kSweeps; }));
  seen.change([](auto& list) {
    for (std::uint64_t i = 0; i < list.size(); ++i) EXPECT_EQ(list[i], i);
  });
  EXPECT_EQ(reader->accounts().at(0).recovered, kSweeps);
}

// Of the graph: submaps end while the robot stands, and poses do not.
TEST(Silence, AnInputThatFollowsTheTravelReportsNone) {
  const Network network(2);
  Watched<int> came;
  RunningStage reader(network.open(0), setup("graph", "i"), [&](Stage& core) {
    InletOptions submaps;
    submaps.regular = false;
    const auto count = [&came](const auto&) { came.change([](int& n) { ++n; }); };
    core.inlet<msg::Odometry>(Key::kOdometry, submaps, count);
    core.inlet<msg::Sweep>(Key::kSweep, {}, count);
  });
  zenoh::Session source = network.open(1);
  const auto put = [&source](Key key, Buffer message) {
    zenoh::PublisherOptions options;
    options.encoding = encoding_of(key);
    zenoh::Publisher out = source.declare_publisher(kKeys.of(key), options);
    wait_for_reader(out);
    out.put(zenoh::Bytes::own(std::move(message)));
  };
  const HeaderFields h = sweep_header(1, 0, false);
  put(Key::kOdometry, build(h, OdometryFields{}));
  put(Key::kSweep, build(h, SweepFields{.rings = 16}));
  ASSERT_TRUE(came.wait([](int n) { return n == 2; }));
  const auto until = std::chrono::steady_clock::now() + kPatience;
  std::string reason;
  while (reason.find("silent") == std::string::npos && std::chrono::steady_clock::now() < until) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    reason = reader->status().reason;
  }
  EXPECT_NE(reason.find("silent " + kKeys.of(Key::kSweep)), std::string::npos) << reason;
  EXPECT_EQ(reason.find("silent " + kKeys.of(Key::kOdometry)), std::string::npos) << reason;
}

// A handler may take longer than sweeps take to become a silence: what waits for it has come.
TEST(Silence, AStageWhoseWorkerIsBusyDoesNotReportOne) {
  const Network network(2);
  std::promise<void> busy, done;
  RunningStage reader(network.open(0), setup("registration", "i"), [&](Stage& core) {
    core.inlet<msg::Sweep>(Key::kSweep, {}, [&](const Received<msg::Sweep>& sweep) {
      if (sweep.sweep() != 30) return;
      busy.set_value();
      done.get_future().wait();
    });
  });
  RunningStage driver(network.open(1), setup("driver"), [&](Stage& core) {
    Outlet& out = core.outlet(Key::kSweep);
    auto next = std::make_shared<std::uint64_t>(0);
    core.every(std::chrono::milliseconds(50), [&out, next] {
      HeaderFields h = sweep_header(1, *next, false);
      h.stamp_ns = static_cast<std::int64_t>((*next)++) * 50'000'000;
      h.seq = out.header(0, 0).seq;
      out.publish(h, build(h, SweepFields{.rings = 16}));
    });
  });
  busy.get_future().wait();
  for (int i = 0; i < 30; ++i) {
    EXPECT_EQ(reader->status().reason.find("silent "), std::string::npos)
        << reader->status().reason;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  done.set_value();
}

}  // namespace
}  // namespace zloam::runtime
