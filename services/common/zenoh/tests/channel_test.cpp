// Channel subscribers: a ring keeps the newest, a FIFO loses nothing and can always be left.
#include <gtest/gtest.h>

#include <thread>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

TEST(Channel, RingKeepsTheNewestAndCountsTheRest) {
  Session session = lone_session();
  auto ring = session.declare_channel_subscriber("test/a", ChannelKind::kRing, 4);
  for (int i = 0; i < 100; ++i) session.put("test/a", Bytes::copy_of(std::to_string(i)));
  for (int i = 96; i < 100; ++i) {
    const auto sample = ring.try_recv();
    ASSERT_TRUE(sample.has_value());
    EXPECT_EQ(sample->payload.to_string(), std::to_string(i));
  }
  EXPECT_FALSE(ring.try_recv().has_value());
  EXPECT_EQ(ring.dropped(), 96u);
}

TEST(Channel, FifoLosesNothing) {
  Session session = lone_session();
  auto fifo = session.declare_channel_subscriber("test/a", ChannelKind::kFifo, 3);
  std::thread producer([&] {
    for (int i = 0; i < 200; ++i) session.put("test/a", Bytes::copy_of(std::to_string(i)));
  });
  for (int i = 0; i < 200; ++i) {
    const auto sample = fifo.recv(kPatience);
    EXPECT_EQ(sample ? sample->payload.to_string() : "nothing", std::to_string(i));
  }
  producer.join();
  EXPECT_EQ(fifo.dropped(), 0u);
}

TEST(Channel, RecvWaitsForASampleOfAnotherSession) {
  Pair pair;
  auto ring = pair.b.declare_channel_subscriber("test/a", ChannelKind::kRing, 1);
  EXPECT_FALSE(ring.recv(std::chrono::milliseconds(1)).has_value());
  Publisher publisher = pair.a.declare_publisher("test/a");
  wait_matching(publisher);
  std::thread producer([&] { publisher.put(Bytes::copy_of("late")); });
  const auto sample = ring.recv(kPatience);
  producer.join();
  ASSERT_TRUE(sample.has_value());
  EXPECT_EQ(sample->payload.to_string(), "late");
}

/// Fills a FIFO of one sample from another thread; ends when nothing holds the thread any more.
struct Filler {
  explicit Filler(Session& session) : thread([&session, this] { fill(session); }) {}
  ~Filler() { thread.join(); }
  void fill(Session& session) {
    for (int i = 0; i < 3; ++i) {
      try {
        session.put("test/a", Bytes::copy_of("x"));
      } catch (const ZenohError&) {  // closed meanwhile
      }
      started.change([](int& n) { ++n; });
    }
  }
  Watched<int> started;
  std::thread thread;
};

TEST(Channel, DestroyingAFullFifoFreesWhoWaits) {
  Session session = lone_session();
  auto fifo =
      std::make_optional(session.declare_channel_subscriber("test/a", ChannelKind::kFifo, 1));
  Filler filler(session);
  ASSERT_TRUE(filler.started.wait([](int n) { return n >= 1; }));
  fifo.reset();
}

TEST(Channel, ClosingTheSessionFreesWhoWaits) {
  Session session = lone_session();
  auto fifo = session.declare_channel_subscriber("test/a", ChannelKind::kFifo, 1);
  Filler filler(session);
  ASSERT_TRUE(filler.started.wait([](int n) { return n >= 1; }));
  EXPECT_TRUE(session.close(kPatience));
  EXPECT_TRUE(fifo.try_recv().has_value());  // what was there before is not lost
}

TEST(Channel, NeedsRoom) {
  Session session = lone_session();
  EXPECT_THROW(session.declare_channel_subscriber("test/a", ChannelKind::kRing, 0), ZenohError);
}

}  // namespace
}  // namespace zloam::zenoh::test
