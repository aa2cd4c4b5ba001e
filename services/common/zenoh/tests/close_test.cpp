// Closing ends in time, or returns at the deadline and reports that it did not.
#include <gtest/gtest.h>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

TEST(Close, IsFinalAndMayBeRepeated) {
  Session session = lone_session();
  Publisher publisher = session.declare_publisher("test/a");
  const auto subscriber = session.declare_subscriber("test/a", [](Sample&&) {});
  const auto queryable = session.declare_queryable("test/a", [](Query&&) {});
  const auto token = session.declare_liveliness_token("alive/a");
  EXPECT_TRUE(session.close(kPatience));
  EXPECT_TRUE(session.close(kPatience));
  EXPECT_THROW(publisher.put(Bytes::copy_of("x")), ZenohError);
  EXPECT_THROW(session.put("test/a", Bytes()), ZenohError);
  EXPECT_THROW(session.get("test/a"), ZenohError);
  EXPECT_THROW(session.declare_publisher("test/b"), ZenohError);
  EXPECT_THROW(session.declare_liveliness_token("alive/b"), ZenohError);
}

TEST(Close, WaitsForCallbacksButNotBeyondTheDeadline) {
  Pair pair;
  Watched<bool> inside;
  Watched<bool> release;
  const auto subscriber = pair.b.declare_subscriber("test/a", [&](Sample&&) {
    inside.change([](bool& v) { v = true; });
    EXPECT_TRUE(release.wait([](bool v) { return v; }));
  });
  Publisher publisher = pair.a.declare_publisher("test/a");
  wait_matching(publisher);
  publisher.put(Bytes::copy_of("x"));
  ASSERT_TRUE(inside.wait([](bool v) { return v; }));
  EXPECT_FALSE(pair.b.close(std::chrono::milliseconds(20)));
  release.change([](bool& v) { v = true; });
  EXPECT_TRUE(pair.b.close(kPatience));
}

TEST(Close, EndsARunningGet) {
  Session session = lone_session();
  Watched<std::vector<Query>> held;
  const auto queryable = session.declare_queryable("test/a", [&](Query&& query) {
    held.change([&](auto& queries) { queries.push_back(std::move(query)); });
  });
  const auto done = std::make_shared<Watched<bool>>();
  GetOptions options;
  options.timeout = 10 * kPatience;
  session.get(
      "test/a", [](Reply&&) {}, [done] { done->change([](bool& v) { v = true; }); }, options);
  ASSERT_TRUE(held.wait([](const auto& queries) { return queries.size() == 1; }));
  EXPECT_TRUE(session.close(kPatience));
  EXPECT_TRUE(done->wait([](bool v) { return v; }));
}

}  // namespace
}  // namespace zloam::zenoh::test
