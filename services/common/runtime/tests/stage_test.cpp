// One stage and another session: which messages are refused, and how the accounts count them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

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

zenoh::PublisherOptions sweep_options() {
  zenoh::PublisherOptions o;
  o.congestion_control = zenoh::CongestionControl::kBlock;
  o.encoding = encoding_of(Key::kSweep);
  return o;
}

zenoh::Bytes sweep_bytes(const HeaderFields& header, std::span<const Point> points = {}) {
  return zenoh::Bytes::own(build(header, SweepFields{.points = points, .rings = 16}));
}

/// A stage that records the sweeps that it handles.
struct Reader {
  Reader(zenoh::Session session, StageSetup s, InletOptions options = {}) {
    options.on_given_up = [this](std::uint64_t, std::uint64_t sweep, std::string_view reason) {
      seen.change([&](auto& list) { list.push_back(std::string(reason) + std::to_string(sweep)); });
    };
    stage = std::make_unique<RunningStage>(std::move(session), std::move(s), [&](Stage& core) {
      core.inlet<msg::Sweep>(Key::kSweep, options, [this](const Received<msg::Sweep>& sweep) {
        hold.wait([](bool held) { return !held; });
        seen.change([&](auto& list) { list.push_back(std::to_string(sweep.sweep())); });
      });
    });
  }
  Account account() { return (*stage)->accounts().at(0); }
  bool wait_for(std::size_t n) {
    return seen.wait([n](const auto& list) { return list.size() >= n; });
  }
  Watched<std::vector<std::string>> seen;
  Watched<bool> hold;
  std::unique_ptr<RunningStage> stage;
};

std::uint64_t dropped(const Account& a, Drop reason) {
  return a.dropped[static_cast<std::size_t>(reason)];
}

TEST(Stage, RefusesWhatIsNoMessageAndCountsWhy) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session stranger = network.open(1);
  zenoh::Publisher good = stranger.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  zenoh::PublisherOptions wrong = sweep_options();
  wrong.encoding = "text/plain";
  zenoh::Publisher other = stranger.declare_publisher(kKeys.of(Key::kSweep), wrong);
  wait_for_reader(good);
  wait_for_reader(other);

  good.put(sweep_bytes(sweep_header(1, 0, true)));
  other.put(sweep_bytes(sweep_header(1, 1, true)));                                // encoding
  good.put(zenoh::Bytes::copy_of(std::string_view("no message")));                 // no FlatBuffer
  good.put(zenoh::Bytes());                                                        // nothing at all
  good.put(zenoh::Bytes::own(build(sweep_header(1, 1, true), FeaturesFields{})));  // identifier
  const Buffer whole = build(sweep_header(1, 1, true), SweepFields{});
  good.put(zenoh::Bytes::copy_of(std::span(whole.data(), whole.size() / 2)));  // cut
  const std::vector<Point> bad = {{1, 1, 1, 1, 0, 99, ReturnType::kStrongest, 0}};
  good.put(sweep_bytes(sweep_header(1, 1, true), bad));  // ring out of range
  good.put(sweep_bytes(sweep_header(1, 0, true)));       // second copy
  good.put(sweep_bytes(sweep_header(1, 1, true)));
  ASSERT_TRUE(reader.wait_for(2));
  reader.stage->stop();
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.received, 9U);
  EXPECT_EQ(a.processed, 2U);
  EXPECT_EQ(dropped(a, Drop::kGarbage), 5U);
  EXPECT_EQ(dropped(a, Drop::kInvalid), 1U);
  EXPECT_EQ(dropped(a, Drop::kDuplicate), 1U);
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "1"));
}

TEST(Stage, RefusesWhatIsLargerThanAnyMessageOfTheKey) {
  const Network network(2);
  RunningStage stage(network.open(0), setup("integration"), [](Stage& core) {
    core.inlet<msg::Odometry>(Key::kOdometry, {}, [](const Received<msg::Odometry>&) {});
  });
  zenoh::Session stranger = network.open(1);
  zenoh::PublisherOptions options = sweep_options();
  options.encoding = encoding_of(Key::kOdometry);
  zenoh::Publisher out = stranger.declare_publisher(kKeys.of(Key::kOdometry), options);
  wait_for_reader(out);
  const std::size_t most = key_row(Key::kOdometry).max_bytes;
  // The message is well formed, so only its size can be the reason of the drop.
  HeaderFields header = sweep_header(1, 0, true);
  header.frame = std::string(most, 'x');
  out.put(zenoh::Bytes::own(build(header, OdometryFields{})));
  header.frame = "odom";
  out.put(zenoh::Bytes::own(build(header, OdometryFields{})));
  while (stage->accounts().at(0).processed == 0) std::this_thread::yield();
  stage.stop();
  const Account a = stage->accounts().at(0);
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.received, 2U);
  EXPECT_EQ(a.processed, 1U);
  EXPECT_EQ(dropped(a, Drop::kGarbage), 1U);
}

TEST(Stage, LiveQueueDropsTheOldestAndTellsWhich) {
  const Network network(2);
  StageSetup s = setup("registration");
  s.shared.recovery.queue_sweeps = 2;
  Reader reader(network.open(0), std::move(s));
  reader.hold.change([](bool& h) { h = true; });
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  constexpr std::uint64_t kSent = 9;
  for (std::uint64_t i = 0; i < kSent; ++i) out.put(sweep_bytes(sweep_header(1, i, false)));
  // Wait for the counter instead of a fixed time: it shows when all messages have arrived.
  while (reader.account().received < kSent) std::this_thread::yield();
  reader.hold.change([](bool& h) { h = false; });
  ASSERT_TRUE(reader.wait_for(kSent));
  reader.stage->stop();
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.processed + dropped(a, Drop::kQueueFull), kSent);
  EXPECT_GE(dropped(a, Drop::kQueueFull), 4U);
  EXPECT_EQ(reader.seen.get().back(), "8");
  std::uint64_t told = 0;
  for (const std::string& entry : reader.seen.get()) told += entry.starts_with("queue_full");
  EXPECT_EQ(told, dropped(a, Drop::kQueueFull));
}

struct NoEvents : InletEvents {
  void saw(std::uint64_t, std::uint64_t) override {}
  bool follows(const Message&) override { return true; }
  bool before_message(const Message&) override { return true; }
  void after_message(const Message&, bool) override {}
  void second_copy(std::uint64_t, std::uint64_t) override {}
  void overdue(const std::string&, std::uint64_t) override {}
  void handler_threw(const std::string&, std::uint64_t, const std::string&) override {}
};

// Of the store, while its disk is slow: what the worker has verified counts, too.
TEST(Inlet, WhatWaitsInOrderOfArrivalIsBoundedByItsBytes) {
  const auto sample = [](std::uint64_t seq) {
    zenoh::Sample s;
    s.payload = sweep_bytes(sweep_header(1, seq, true));
    s.encoding = encoding_of(Key::kSweep);
    return s;
  };
  InletSetup s;
  s.options.order = Order::kAsTheyCome;
  s.queue_bytes = 3 * sample(1).payload.size();
  s.verify = &verify<msg::Sweep>;
  s.header = [](std::span<const std::uint8_t> bytes) {
    return message_of<msg::Sweep>(bytes).header();
  };
  s.handler = [](const Message&) { return Outcome::kProcessed; };
  NoEvents events;
  const auto inlet = std::make_shared<InletCore>(std::move(s), std::make_shared<Shared>(), events);
  for (std::uint64_t seq = 1; seq <= 5; ++seq) {
    inlet->on_sample(sample(seq), false);
    inlet->drain();
  }
  EXPECT_EQ(inlet->account().queued, 3U);
  EXPECT_EQ(dropped(inlet->account(), Drop::kQueueFull), 2U);
  EXPECT_TRUE(inlet->work());
  inlet->on_sample(sample(6), false);
  inlet->drain();
  while (inlet->work()) {
  }
  EXPECT_EQ(inlet->account().processed, 4U);
  EXPECT_TRUE(inlet->account().balanced());
}

// As odometry after a standstill, which gets what it missed from the stage before it.
TEST(Stage, WaitingSweepsThatItsHandlerHasFromElsewhereAreSettled) {
  const Network network(2);
  StageSetup s = setup("registration");
  s.shared.recovery.queue_sweeps = 16;
  s.shared.recovery.late_ms = 60'000;
  Watched<std::vector<std::uint64_t>> seen;
  Inlet* inlet = nullptr;
  RunningStage reader(network.open(0), std::move(s), [&](Stage& stage) {
    inlet = &stage.inlet<msg::Sweep>(Key::kSweep, {}, [&](const Received<msg::Sweep>& sweep) {
      if (sweep.sweep() == 1) inlet->continue_at(1, 4);
      seen.change([&](auto& sweeps) { sweeps.push_back(sweep.sweep()); });
    });
  });
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  // 2 and 3 arrive before 1, so that they wait when it is handled.
  for (const std::uint64_t sweep : {0U, 2U, 3U, 1U, 4U}) {
    out.put(sweep_bytes(sweep_header(1, sweep, false)));
  }
  ASSERT_TRUE(seen.wait([](const auto& sweeps) { return sweeps.size() == 3; }));
  EXPECT_THAT(seen.get(), testing::ElementsAre(0U, 1U, 4U));
  reader.stop();
  const Account a = reader->accounts().at(0);
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.queued, 0U);
  EXPECT_EQ(a.not_mine, 2U);
}

TEST(Stage, LiveGapIsGivenUpAndALateArrivalIsLate) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, false)));
  out.put(sweep_bytes(sweep_header(1, 2, false)));
  ASSERT_TRUE(reader.wait_for(3));
  out.put(sweep_bytes(sweep_header(1, 1, false)));
  out.put(sweep_bytes(sweep_header(1, 3, false)));
  ASSERT_TRUE(reader.wait_for(4));
  reader.stage->stop();
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "lost1", "2", "3"));
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(a.lost, 1U);
  EXPECT_EQ(dropped(a, Drop::kLate), 1U);
}

TEST(Stage, AnotherRunIsRefusedAndTheDriversGoesOn) {
  const Network network(2);
  Reader reader(network.open(0), setup("registration"));
  zenoh::Session source = network.open(1);
  const zenoh::LivelinessToken token = source.declare_liveliness_token(kKeys.run("d", "1"));
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, false)));
  for (std::uint64_t run = 2; run < 50; ++run) out.put(sweep_bytes(sweep_header(run, 0, false)));
  out.put(sweep_bytes(sweep_header(1, 900'000, false)));
  out.put(sweep_bytes(sweep_header(1, 1, true)));  // marked as a replay in a live run
  out.put(sweep_bytes(sweep_header(1, 1, false)));
  ASSERT_TRUE(reader.wait_for(2));
  reader.stage->stop();
  EXPECT_THAT(reader.seen.get(), testing::ElementsAre("0", "1"));
  const Account a = reader.account();
  EXPECT_TRUE(a.balanced());
  EXPECT_EQ(dropped(a, Drop::kWrongRun), 49U);
  EXPECT_EQ(dropped(a, Drop::kInvalid), 1U);
}

TEST(Stage, OfTwoInstancesTheElderPublishesAndBothSaySo) {
  const Network network(3);
  zenoh::Session listener = network.open(2);
  Watched<std::set<std::string>> publishers;
  const zenoh::Subscriber subscriber =
      listener.declare_subscriber(kKeys.of(Key::kPose), [&](zenoh::Sample&& sample) {
        const zenoh::AlignedBytes bytes = zenoh::view_aligned(sample.payload);
        const auto name = message_of<msg::MapPose>(bytes.data()).header()->instance()->str();
        publishers.change([&](auto& names) { names.insert(name); });
      });
  const auto publish = [](Stage& stage) {
    Outlet& out = stage.outlet(Key::kPose);
    stage.every(std::chrono::milliseconds(10), [&stage, &out] {
      HeaderFields h = out.header(stage.now_ns(), stage.now_ns());
      h.frame = "map";
      out.publish(h, build(h, MapPoseFields{}));
    });
  };
  auto elder =
      std::make_unique<RunningStage>(network.open(0), setup("integration", "elder"), publish);
  ASSERT_TRUE(publishers.wait([](const auto& names) { return names.contains("elder"); }));
  RunningStage younger(network.open(1), setup("integration", "younger"), publish);
  const auto says = [](RunningStage& stage, const std::string& other) {
    return stage->status().reason.find(other) != std::string::npos;
  };
  while (!says(*elder, "younger") || !says(younger, "elder")) std::this_thread::yield();
  publishers.change([](auto& names) { names.clear(); });
  ASSERT_TRUE(publishers.wait([](const auto& names) { return !names.empty(); }));
  EXPECT_THAT(publishers.get(), testing::ElementsAre("elder"));
  elder.reset();
  ASSERT_TRUE(publishers.wait([](const auto& names) { return names.contains("younger"); }));
  while (says(younger, "elder")) std::this_thread::yield();
}

TEST(Stage, WhoIsSilentTakesNothingAndBeginsWhereTheOtherEnds) {
  const Network network(3);
  auto elder = std::make_unique<Reader>(network.open(0), setup("integration", "elder"));
  Reader younger(network.open(1), setup("integration", "younger"));
  while ((*younger.stage)->status().reason.find("elder") == std::string::npos) {
    std::this_thread::yield();
  }
  zenoh::Session source = network.open(2);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  std::uint64_t sweep = 0;
  const auto put_until = [&](const auto& enough) {
    for (; !enough(); ++sweep) {
      out.put(sweep_bytes(sweep_header(1, sweep, false)));
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  };
  put_until([&] { return elder->seen.get().size() >= 5 && younger.account().not_mine >= 5; });
  EXPECT_THAT(younger.seen.get(), testing::IsEmpty());
  elder.reset();
  put_until([&] { return younger.seen.get().size() >= 5; });
  younger.stage->stop();
  // Each number came once, and in order.
  EXPECT_GE(std::stoull(younger.seen.get().front()), younger.account().not_mine);
  EXPECT_TRUE(younger.account().balanced());
  EXPECT_EQ(younger.account().lost, 0U);
}

TEST(Stage, AHandlerThatThrowsCostsItsMessageOnly) {
  const Network network(2);
  Watched<int> handled;
  RunningStage stage(network.open(0), setup("registration"), [&](Stage& core) {
    core.inlet<msg::Sweep>(Key::kSweep, {}, [&](const Received<msg::Sweep>& sweep) {
      if (sweep.sweep() == 0) throw std::runtime_error("on purpose");
      handled.change([](int& n) { ++n; });
    });
  });
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kSweep), sweep_options());
  wait_for_reader(out);
  out.put(sweep_bytes(sweep_header(1, 0, true)));
  out.put(sweep_bytes(sweep_header(1, 1, true)));
  ASSERT_TRUE(handled.wait([](int n) { return n == 1; }));
  EXPECT_EQ(stage->status().health, ServiceHealth::kDegraded);
  EXPECT_THAT(stage->status().reason, testing::HasSubstr("on purpose"));
  EXPECT_EQ(stage.stop(), kExitOk);
  EXPECT_TRUE(stage->accounts().at(0).balanced());
}

TEST(Stage, AResultThatIsLostIsToldUntilTheEndAndInTheExitCode) {
  const Network network(1);
  RunningStage stage(network.open(0), setup("mapping"), [](Stage& core) {
    core.lost_output("");
    core.lost_output("out/map.pcd: no space left");
    core.degraded("map file", "");
  });
  while ((*stage).status().health == ServiceHealth::kStarting) std::this_thread::yield();
  EXPECT_EQ(stage->status().reason, "lost output: out/map.pcd: no space left");
  EXPECT_EQ(stage.stop(), kExitIo);
}

}  // namespace
}  // namespace zloam::runtime
