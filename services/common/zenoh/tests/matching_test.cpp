// A publisher knows whether it has a subscriber.
#include <gtest/gtest.h>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

TEST(Matching, ChangesAreReported) {
  Pair pair;
  Publisher publisher = pair.a.declare_publisher("test/a");
  EXPECT_FALSE(publisher.matching());
  const auto changes = std::make_shared<Watched<std::vector<bool>>>();
  publisher.on_matching(
      [changes](bool now) { changes->change([&](auto& all) { all.push_back(now); }); });
  Mailbox unrelated(pair.b, "other/*", 4);
  std::optional<Mailbox> subscriber(std::in_place, pair.b, "test/*");
  ASSERT_TRUE(changes->wait([](const auto& all) { return all.size() == 1; }));
  EXPECT_TRUE(publisher.matching());
  subscriber.reset();
  ASSERT_TRUE(changes->wait([](const auto& all) { return all.size() == 2; }));
  EXPECT_FALSE(publisher.matching());
  EXPECT_EQ(changes->get(), (std::vector<bool>{true, false}));
}

TEST(Matching, AListenerThatComesLateIsToldAtOnce) {
  Session session = lone_session();
  const auto subscriber = session.declare_subscriber("test/a", [](Sample&&) {});
  Publisher publisher = session.declare_publisher("test/a");
  EXPECT_TRUE(publisher.matching());
  const auto told = std::make_shared<Watched<bool>>();
  publisher.on_matching([told](bool now) { told->change([&](bool& v) { v = now; }); });
  EXPECT_TRUE(told->wait([](bool now) { return now; }));
}

}  // namespace
}  // namespace zloam::zenoh::test
