// A reader refuses what an instance publishes after another one has taken over from it.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

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

/// Publishes odometry to a stage that reads it.
struct Fenced {
  explicit Fenced(Order order = Order::kBySweep) : input(inlet_of(order)) {}

  static InletOptions inlet_of(Order order) {
    InletOptions options;
    options.order = order;
    return options;
  }

  void put(std::uint64_t run, std::uint64_t sweep, std::uint32_t term) {
    HeaderFields h = sweep_header(run, sweep, true);
    h.term = term;
    out.put(zenoh::Bytes::own(build(h, OdometryFields{})));
  }
  /// Publishes it again until `count` messages were taken.
  bool is_taken(std::uint64_t run, std::uint64_t sweep, std::uint32_t term, std::size_t count) {
    const auto until = std::chrono::steady_clock::now() + kPatience;
    while (seen.get().size() < count && std::chrono::steady_clock::now() < until) {
      put(run, sweep, term);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return seen.get().size() >= count;
  }
  std::uint64_t dropped(Drop reason) {
    return reader->accounts().at(0).dropped[static_cast<std::size_t>(reason)];
  }

  InletOptions input;
  Network network{2};
  Watched<std::vector<std::uint64_t>> seen;
  RunningStage reader{network.open(0), setup("integration"), [this](Stage& stage) {
                        stage.inlet<msg::Odometry>(
                            Key::kOdometry, input, [this](const Received<msg::Odometry>& odometry) {
                              seen.change([&](auto& all) { all.push_back(odometry.sweep()); });
                            });
                      }};
  zenoh::Session source = network.open(1);
  zenoh::Publisher out = [this] {
    zenoh::PublisherOptions options;
    options.encoding = encoding_of(Key::kOdometry);
    return source.declare_publisher(kKeys.of(Key::kOdometry), options);
  }();
};

TEST(Fencing, WhoWasOvertakenAndDoesNotKnowItIsFenced) {
  Fenced f;
  wait_for_reader(f.out);
  f.put(1, 0, 1);
  f.put(1, 1, 2);
  f.put(1, 2, 1);
  f.put(1, 2, 2);
  f.put(1, 3, 2);
  ASSERT_TRUE(f.seen.wait([](const auto& list) { return list.size() == 4; }));
  EXPECT_THAT(f.seen.get(), testing::ElementsAre(0, 1, 2, 3));
  EXPECT_EQ(f.dropped(Drop::kFenced), 1U);
  EXPECT_EQ(f.dropped(Drop::kDuplicate), 0U);
}

// After two hand-overs the first process works again, under its name, and begins to count again.
TEST(Fencing, TheNumbersOfWhoTakesOverAgainBeginAgain) {
  Fenced f(Order::kAsTheyCome);
  wait_for_reader(f.out);
  for (const std::uint32_t term : {1U, 3U}) {
    for (const std::uint64_t number : {0U, 1U}) f.put(1, number, term);
  }
  EXPECT_TRUE(f.seen.wait([](const auto& list) { return list.size() == 4; }));
  EXPECT_EQ(f.dropped(Drop::kDuplicate), 0U);
}

// A driver that took over, and is restarted: it is alone, so it begins at term 1 again.
TEST(Fencing, TheNextRunIsNotFencedByTheTermsOfTheLast) {
  Fenced f;
  wait_for_reader(f.out);
  auto token = f.source.declare_liveliness_token(kKeys.run("d", "1"));
  ASSERT_TRUE(f.is_taken(1, 0, 2, 1));
  token = f.source.declare_liveliness_token(kKeys.run("d", "2"));
  ASSERT_TRUE(f.is_taken(2, 0, 1, 2));
  EXPECT_EQ(f.dropped(Drop::kFenced), 0U);
}

// Else features that name it would have odometry refuse the true ones for two seconds.
TEST(Fencing, TheTermOfAMessageThatIsRefusedIsNotTheInputs) {
  const Network network(2);
  Watched<std::vector<std::uint32_t>> terms;
  const Inlet* input = nullptr;
  RunningStage reader(network.open(0), setup("integration"), [&](Stage& stage) {
    input = &stage.inlet<msg::Odometry>(Key::kOdometry, InletOptions{},
                                        [](const Received<msg::Odometry>&) {});
    stage.on_poll([&] {
      terms.change([&](auto& list) { list.push_back(input->term()); });
      return Poll::kWait;
    });
  });
  const auto has_refused = [&] {
    return reader->accounts().at(0).dropped[static_cast<std::size_t>(Drop::kDuplicate)] > 0;
  };
  zenoh::Session source = network.open(1);
  zenoh::PublisherOptions options;
  options.encoding = encoding_of(Key::kOdometry);
  zenoh::Publisher out = source.declare_publisher(kKeys.of(Key::kOdometry), options);
  wait_for_reader(out);
  const auto put = [&](std::uint32_t term) {
    HeaderFields h = sweep_header(1, 0, true);
    h.term = term;
    out.put(zenoh::Bytes::own(build(h, OdometryFields{})));
  };
  put(3);
  ASSERT_TRUE(terms.wait([](const auto& list) { return !list.empty() && list.back() == 3; }));
  put(9);
  const auto until = std::chrono::steady_clock::now() + kPatience;
  while (!has_refused() && std::chrono::steady_clock::now() < until) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  ASSERT_TRUE(has_refused());
  terms.change([](auto& list) { list.clear(); });
  ASSERT_TRUE(terms.wait([](const auto& list) { return !list.empty(); }));
  EXPECT_EQ(terms.get().back(), 3U);
}

}  // namespace
}  // namespace zloam::runtime
