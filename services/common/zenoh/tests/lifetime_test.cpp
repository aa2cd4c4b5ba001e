// Entities may be destroyed while traffic runs: afterwards no callback touches what it captured.
// Made to be run under AddressSanitizer.
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

constexpr int kRounds = 200;

/// Runs f over and over on a thread of its own until it is destroyed.
class Traffic {
 public:
  template <class F>
  explicit Traffic(F f)
      : thread_([this, f = std::move(f)]() mutable {
          while (!stop_) f();
        }) {}
  ~Traffic() {
    stop_ = true;
    thread_.join();
  }

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

/// State that callbacks capture by reference, destroyed right after the entity. Callbacks take a
/// while, so that the entity is destroyed while one runs.
struct Captured {
  Watched<int> calls;
  std::atomic<int> running{0};
  std::vector<int> memory = std::vector<int>(4, 1);

  void touch() {
    ++running;
    calls.change([](int& n) { ++n; });
    for (int& value : memory) {
      std::this_thread::yield();
      ++value;
    }
    --running;
  }
};

PublisherOptions blocking() {
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  return options;
}

TEST(Lifetime, SubscriberUnderTraffic) {
  Pair pair;
  Publisher publisher = pair.a.declare_publisher("test/a", blocking());
  const Traffic traffic([&] { publisher.put(Bytes::copy_of("x")); });
  for (int round = 0; round < kRounds; ++round) {
    const auto captured = std::make_unique<Captured>();
    {
      const auto subscriber =
          pair.b.declare_subscriber("test/a", [&](Sample&&) { captured->touch(); });
      ASSERT_TRUE(captured->calls.wait([](int n) { return n > 0; })) << round;
    }
    ASSERT_EQ(captured->running, 0) << round;
  }
}

TEST(Lifetime, QueryableUnderQueries) {
  Pair pair;
  GetOptions options;
  // A query in flight while its queryable is undeclared may get no answer (1 of 20 000).
  options.timeout = std::chrono::seconds(1);
  const Traffic traffic([&] { pair.a.get("test/a", options); });
  for (int round = 0; round < kRounds; ++round) {
    const auto captured = std::make_unique<Captured>();
    {
      const auto queryable = pair.b.declare_queryable("test/a", [&](Query&& query) {
        query.reply("test/a", Bytes::copy_of("answer"));
        captured->touch();
      });
      ASSERT_TRUE(captured->calls.wait([](int n) { return n > 0; })) << round;
    }
    ASSERT_EQ(captured->running, 0) << round;
  }
}

TEST(Lifetime, PublisherWhoseListenerIsCalled) {
  Pair pair;
  const Traffic traffic(
      [&] { const auto subscriber = pair.b.declare_subscriber("test/a", [](Sample&&) {}); });
  for (int round = 0; round < kRounds; ++round) {
    const auto captured = std::make_unique<Captured>();
    {
      Publisher publisher = pair.a.declare_publisher("test/a");
      publisher.on_matching([&](bool) { captured->touch(); });
      publisher.put(Bytes::copy_of("x"));
      ASSERT_TRUE(captured->calls.wait([](int n) { return n > 0; })) << round;
    }
    ASSERT_EQ(captured->running, 0) << round;
  }
}

TEST(Lifetime, TokensUnderAWatcher) {
  Pair pair;
  const auto captured = std::make_unique<Captured>();
  const auto watcher = pair.a.declare_liveliness_subscriber(
      "alive/*", [&](Sample&&) { captured->touch(); }, true);
  for (int round = 0; round < kRounds; ++round) {
    const auto token = pair.b.declare_liveliness_token("alive/" + std::to_string(round));
  }
  ASSERT_TRUE(captured->calls.wait([](int n) { return n > 0; }));
}

TEST(Lifetime, EntitiesKeepTheirSessionOpen) {
  std::optional<Session> session(lone_session());
  const auto calls = std::make_shared<Watched<int>>();
  const auto subscriber = session->declare_subscriber(
      "test/a", [calls](Sample&&) { calls->change([](int& n) { ++n; }); });
  Publisher publisher = session->declare_publisher("test/a");
  session.reset();
  publisher.put(Bytes::copy_of("x"));
  EXPECT_TRUE(calls->wait([](int n) { return n == 1; }));
}

TEST(Lifetime, MovedEntitiesWorkAndAreUndeclaredOnce) {
  Session session = lone_session();
  const auto calls = std::make_shared<Watched<int>>();
  const auto count = [calls](Sample&&) { calls->change([](int& n) { ++n; }); };
  Subscriber subscriber = session.declare_subscriber("test/a", count);
  Publisher first = session.declare_publisher("test/a");
  Publisher second = std::move(first);
  Subscriber moved = std::move(subscriber);
  second.put(Bytes::copy_of("one"));
  EXPECT_TRUE(calls->wait([](int n) { return n == 1; }));
  moved = session.declare_subscriber("test/b", count);
  second.put(Bytes::copy_of("two"));
  EXPECT_EQ(calls->get(), 1);
}

TEST(Lifetime, SamplesAndQueriesOutliveTheirSession) {
  std::optional<Sample> sample;
  Watched<std::optional<Query>> held;
  {
    Session session = lone_session();
    Mailbox channel(session, "test/a", 4);
    session.put("test/a", Bytes::copy_of("kept"));
    sample = channel.recv(kPatience);
    const auto queryable = session.declare_queryable("test/q", [&](Query&& query) {
      held.change([&](auto& place) { place.emplace(std::move(query)); });
    });
    session.get(
        "test/q", [](Reply&&) {}, [] {}, GetOptions());
    ASSERT_TRUE(held.wait([](const auto& place) { return place.has_value(); }));
  }
  ASSERT_TRUE(sample.has_value());
  EXPECT_EQ(sample->payload.to_string(), "kept");
  held.change([](auto& place) { place.reset(); });
}

}  // namespace
}  // namespace zloam::zenoh::test
