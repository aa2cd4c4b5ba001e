// Tokens are seen to appear and disappear; with history, a subscriber gets earlier tokens too.
#include <gtest/gtest.h>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

using Events = Watched<std::vector<std::string>>;

auto note_in(const std::shared_ptr<Events>& events) {
  return [events](Sample&& sample) {
    const char* sign = sample.kind == SampleKind::kPut ? "+" : "-";
    events->change([&](auto& all) { all.push_back(sign + sample.key); });
  };
}

bool has(const std::vector<std::string>& all, const std::string& one) {
  return std::find(all.begin(), all.end(), one) != all.end();
}

TEST(Liveliness, TokensComeAndGo) {
  Pair pair;
  const auto events = std::make_shared<Events>();
  const auto watcher = pair.a.declare_liveliness_subscriber("alive/*", note_in(events));
  auto token = std::make_optional(pair.b.declare_liveliness_token("alive/one"));
  ASSERT_TRUE(events->wait([](const auto& all) { return has(all, "+alive/one"); }));
  token.reset();
  ASSERT_TRUE(events->wait([](const auto& all) { return has(all, "-alive/one"); }));
  EXPECT_EQ(events->get(), (std::vector<std::string>{"+alive/one", "-alive/one"}));
}

TEST(Liveliness, HistoryTellsWhoWasThereBefore) {
  Pair pair;
  const auto token = pair.b.declare_liveliness_token("alive/early");
  const auto first = std::make_shared<Events>();
  const auto with_history = pair.a.declare_liveliness_subscriber("alive/*", note_in(first), true);
  ASSERT_TRUE(first->wait([](const auto& all) { return has(all, "+alive/early"); }));
  // The token is known by now; a watcher without history sees only what comes after it.
  const auto second = std::make_shared<Events>();
  const auto without = pair.a.declare_liveliness_subscriber("alive/*", note_in(second), false);
  const auto late = pair.b.declare_liveliness_token("alive/late");
  ASSERT_TRUE(second->wait([](const auto& all) { return has(all, "+alive/late"); }));
  EXPECT_FALSE(has(second->get(), "+alive/early"));
}

TEST(Liveliness, AnEndedSessionIsSeen) {
  const int port = free_port();
  Session watcher_session = Session::open(listening_config(port));
  const auto events = std::make_shared<Events>();
  const auto watcher = watcher_session.declare_liveliness_subscriber("alive/*", note_in(events));
  {
    Session session = Session::open(connecting_config(port));
    const auto token = session.declare_liveliness_token("alive/one");
    ASSERT_TRUE(events->wait([](const auto& all) { return has(all, "+alive/one"); }));
    ASSERT_TRUE(session.close());
    ASSERT_TRUE(events->wait([](const auto& all) { return has(all, "-alive/one"); }));
  }
}

TEST(Liveliness, GetListsTheTokensAliveNow) {
  Pair pair;
  const auto first = pair.b.declare_liveliness_token("alive/one");
  auto second = std::make_optional(pair.b.declare_liveliness_token("alive/two"));
  const auto events = std::make_shared<Events>();
  const auto watcher = pair.a.declare_liveliness_subscriber("alive/*", note_in(events));
  ASSERT_TRUE(events->wait([](const auto& all) { return all.size() == 2; }));
  auto keys = pair.a.liveliness_get("alive/*", kPatience);
  std::sort(keys.begin(), keys.end());
  EXPECT_EQ(keys, (std::vector<std::string>{"alive/one", "alive/two"}));
  second.reset();
  ASSERT_TRUE(events->wait([](const auto& all) { return has(all, "-alive/two"); }));
  EXPECT_EQ(pair.a.liveliness_get("alive/*", kPatience), (std::vector<std::string>{"alive/one"}));
  EXPECT_TRUE(pair.a.liveliness_get("other/*", kPatience).empty());
}

}  // namespace
}  // namespace zloam::zenoh::test
