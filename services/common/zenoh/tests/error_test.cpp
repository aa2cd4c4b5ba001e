// Failures are exceptions with Zenoh's own message, or are counted; none ends the process.
#include <gtest/gtest.h>

#include <cstdio>
#include <fstream>

#include "common/zenoh/detail.hpp"
#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

template <class F>
std::string message_of(F&& f) {
  try {
    f();
  } catch (const ZenohError& error) {
    return error.what();
  }
  return "";
}

bool contains(const std::string& text, std::string_view part) {
  return text.find(part) != std::string::npos;
}

TEST(Errors, BadKeysAreRefused) {
  Session session = lone_session();
  const std::string latin1 = "test/\xff";
  for (const std::string& key : {std::string("a//b"), std::string("/a"), std::string("a/"),
                                 std::string(), std::string("a#b"), latin1}) {
    EXPECT_THROW(session.declare_publisher(key), ZenohError) << key;
    EXPECT_THROW(session.declare_subscriber(key, [](Sample&&) {}), ZenohError) << key;
    EXPECT_THROW(session.declare_queryable(key, [](Query&&) {}), ZenohError) << key;
    EXPECT_THROW(session.declare_liveliness_token(key), ZenohError) << key;
    EXPECT_THROW(session.declare_liveliness_subscriber(key, [](Sample&&) {}), ZenohError) << key;
    EXPECT_THROW(session.put(key, Bytes()), ZenohError) << key;
    EXPECT_THROW(session.get(key), ZenohError) << key;
  }
  EXPECT_TRUE(contains(message_of([&] { session.declare_publisher("a//b"); }), "a//b"));
}

TEST(Errors, BadConfigurationIsRefused) {
  EXPECT_THROW(Config::from_str("{ mode: "), ZenohError);
  EXPECT_THROW(Config::from_str("{ no_such_key: 1 }"), ZenohError);
  EXPECT_THROW(Config::from_str("{ mode: 'nonsense' }"), ZenohError);
  EXPECT_THROW(Config::from_file("/does/not/exist.json5"), ZenohError);
  Config config = Config::create_default();
  EXPECT_TRUE(
      contains(message_of([&] { config.insert_json5("no/such/key", "1"); }), "no/such/key"));
  EXPECT_THROW(config.insert_json5("mode", "{"), ZenohError);
}

TEST(Errors, ConfigurationFromTextAndFile) {
  const std::string text =
      "{ mode: 'peer', scouting: { multicast: { enabled: false } }, "
      "listen: { endpoints: [] } }";
  EXPECT_FALSE(Session::open(Config::from_str(text)).zid().empty());
  const std::string path =
      testing::TempDir() + "zloam_zenoh_" + std::to_string(getpid()) + ".json5";
  std::ofstream(path) << text;
  EXPECT_FALSE(Session::open(Config::from_file(path)).zid().empty());
  std::remove(path.c_str());
}

TEST(Errors, ATakenPortIsReported) {
  const int port = free_port();
  const Session first = Session::open(listening_config(port));
  const std::string message = message_of([&] { Session::open(listening_config(port)); });
  EXPECT_TRUE(contains(message, std::to_string(port))) << message;
  EXPECT_TRUE(contains(message, "in use")) << message;
}

TEST(Errors, APanicInTheBridgeIsAnException) {
  const std::string message =
      message_of([] { detail::check(zloam_test_panic(detail::slice("deliberate")), "test"); });
  EXPECT_FALSE(contains(message, "panic")) << message;
  EXPECT_TRUE(contains(message, "deliberate")) << message;
  EXPECT_EQ(zloam_test_panic(detail::slice("again")), ZLOAM_PANIC);  // the process lives
}

TEST(Errors, AnExceptionInACallbackIsCountedAndReported) {
  Session session = lone_session();
  const auto reports = std::make_shared<Watched<std::vector<std::string>>>();
  session.set_error_handler([reports](std::string_view what) {
    reports->change([&](auto& all) { all.emplace_back(what); });
  });
  const auto calls = std::make_shared<Watched<int>>();
  const auto subscriber = session.declare_subscriber("test/a", [calls](Sample&&) {
    calls->change([](int& n) { ++n; });
    throw std::runtime_error("from a subscriber");
  });
  const auto queryable = session.declare_queryable("test/q", [](Query&&) { throw 1; });  // NOLINT
  session.put("test/a", Bytes::copy_of("one"));
  session.put("test/a", Bytes::copy_of("two"));
  ASSERT_TRUE(calls->wait([](int n) { return n == 2; }));
  EXPECT_TRUE(session.get("test/q").empty());
  ASSERT_TRUE(reports->wait([](const auto& all) { return all.size() == 3; }));
  EXPECT_EQ(session.callback_exceptions(), 3u);
  EXPECT_EQ(reports->get()[0], "from a subscriber");
}

TEST(Errors, AHandlerThatThrowsBreaksNothing) {
  Session session = lone_session();
  session.set_error_handler([](std::string_view) { throw std::runtime_error("handler"); });
  const auto subscriber =
      session.declare_subscriber("test/a", [](Sample&&) { throw std::runtime_error("callback"); });
  session.put("test/a", Bytes());
  EXPECT_EQ(session.callback_exceptions(), 1u);
}

}  // namespace
}  // namespace zloam::zenoh::test
