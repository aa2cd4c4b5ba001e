// Get and its answers.
#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <thread>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

GetOptions patient() {
  GetOptions options;
  options.timeout = kPatience;
  return options;
}

/// Repeats the get until it is answered: the queryable of another session is not known at once.
std::vector<Reply> ask(Session& session, std::string_view selector, GetOptions options = patient(),
                       std::size_t wanted = 1) {
  const auto end = std::chrono::steady_clock::now() + kPatience;
  std::vector<Reply> replies;
  while (replies.size() < wanted && std::chrono::steady_clock::now() < end) {
    replies = session.get(selector, options);
  }
  return replies;
}

TEST(Query, CarriesKeyParametersPayloadAndTheAnswer) {
  Pair pair;
  const auto queryable = pair.b.declare_queryable("test/service", [](Query&& query) {
    const std::string text = query.key() + "|" + query.parameters() + "|";
    query.reply(query.key(), Bytes::copy_of(text + query.payload().to_string()), "text/plain");
  });
  GetOptions options = patient();
  options.payload = Bytes::copy_of("question");
  const auto replies = ask(pair.a, "test/service?run=1;sweep=3..5", options);
  ASSERT_EQ(replies.size(), 1u);
  ASSERT_TRUE(replies[0].ok());
  EXPECT_EQ(replies[0].sample->key, "test/service");
  EXPECT_EQ(replies[0].sample->encoding, "text/plain");
  EXPECT_EQ(replies[0].sample->payload.to_string(), "test/service|run=1;sweep=3..5|question");
}

TEST(Query, WithoutAPayloadOrParametersTheyAreEmpty) {
  Session session = lone_session();
  const auto queryable = session.declare_queryable("test/**", [](Query&& query) {
    const bool empty = query.payload().size() == 0 && query.parameters().empty();
    query.reply(query.key(), Bytes::copy_of(empty ? "yes" : "no"));
  });
  const auto replies = session.get("test/a", patient());
  ASSERT_EQ(replies.size(), 1u);
  EXPECT_EQ(replies[0].sample->payload.to_string(), "yes");
}

TEST(Query, AnErrorReplyIsNotASample) {
  Pair pair;
  const auto queryable = pair.b.declare_queryable(
      "test/service", [](Query&& query) { query.reply_error(Bytes::copy_of("refused")); });
  const auto replies = ask(pair.a, "test/service");
  ASSERT_EQ(replies.size(), 1u);
  EXPECT_FALSE(replies[0].ok());
  EXPECT_EQ(replies[0].error.to_string(), "refused");
}

TEST(Query, MayBeAnsweredLaterFromAnotherThread) {
  Pair pair;
  Watched<std::vector<Query>> waiting;
  const auto queryable = pair.b.declare_queryable("test/service", [&](Query&& query) {
    waiting.change([&](auto& queries) { queries.push_back(std::move(query)); });
  });
  std::thread worker([&] {
    if (!waiting.wait([](const auto& queries) { return !queries.empty(); })) return;
    waiting.change([](auto& queries) {
      for (Query& query : queries) query.reply("test/service", Bytes::copy_of("from a thread"));
      queries.clear();
    });
  });
  const auto replies = ask(pair.a, "test/service");
  worker.join();
  ASSERT_EQ(replies.size(), 1u);
  EXPECT_EQ(replies[0].sample->payload.to_string(), "from a thread");
}

TEST(Query, OneQueryableMayGiveManyAnswers) {
  Pair pair;
  const auto queryable = pair.b.declare_queryable("test/tile/*", [](Query&& query) {
    for (int i = 0; i < 50; ++i) {
      query.reply("test/tile/" + std::to_string(i), Bytes::copy_of(std::to_string(i)));
    }
  });
  const auto replies = ask(pair.a, "test/tile/*");
  std::set<std::string> keys;
  for (const Reply& reply : replies) {
    ASSERT_TRUE(reply.ok());
    EXPECT_EQ(reply.sample->key, "test/tile/" + reply.sample->payload.to_string());
    keys.insert(reply.sample->key);
  }
  EXPECT_EQ(replies.size(), 50u);
  EXPECT_EQ(keys.size(), 50u);
}

TEST(Query, AllQueryablesOfOneKeyAnswerOrOnlyTheBest) {
  Session session = lone_session();
  const auto answer = [](const char* text) {
    return [text](Query&& query) { query.reply(query.key(), Bytes::copy_of(text)); };
  };
  const auto first = session.declare_queryable("test/a", answer("first"));
  const auto second = session.declare_queryable("test/a", answer("second"));
  std::multiset<std::string> texts;
  for (const Reply& reply : session.get("test/a", patient())) {
    texts.insert(reply.sample->payload.to_string());
  }
  EXPECT_EQ(texts, (std::multiset<std::string>{"first", "second"}));
  GetOptions best = patient();
  best.target_all = false;
  EXPECT_GE(session.get("test/a", best).size(), 1u);
}

TEST(Query, WithoutAQueryableThereAreNoAnswers) {
  Session session = lone_session();
  EXPECT_TRUE(session.get("test/nobody", patient()).empty());
}

TEST(Query, WhoDoesNotAnswerIsReportedAfterTheTimeout) {
  Session session = lone_session();
  Watched<std::vector<Query>> held;
  const auto queryable = session.declare_queryable("test/a", [&](Query&& query) {
    held.change([&](auto& queries) { queries.push_back(std::move(query)); });
  });
  GetOptions options;
  options.timeout = std::chrono::milliseconds(50);
  const auto replies = session.get("test/a", options);
  ASSERT_EQ(replies.size(), 1u);
  EXPECT_FALSE(replies[0].ok());
  EXPECT_EQ(replies[0].error.to_string(), "Timeout");
  held.change([](auto& queries) {  // a late reply is ignored
    ASSERT_EQ(queries.size(), 1u);
    queries[0].reply("test/a", Bytes::copy_of("late"));
    queries.clear();
  });
}

TEST(Query, ADroppedQueryEndsWithoutAnAnswer) {
  Session session = lone_session();
  const auto queryable = session.declare_queryable("test/a", [](Query&&) {});
  EXPECT_TRUE(session.get("test/a", patient()).empty());
}

TEST(Query, AsynchronousGetCallsDoneOnceAfterAllAnswers) {
  Pair pair;
  const auto queryable = pair.b.declare_queryable(
      "test/a", [](Query&& query) { query.reply(query.key(), Bytes::copy_of("answer")); });
  ASSERT_EQ(ask(pair.a, "test/a").size(), 1u);
  auto events = std::make_shared<Watched<std::string>>();
  pair.a.get(
      "test/a", [events](Reply&&) { events->change([](auto& text) { text += 'r'; }); },
      [events] { events->change([](auto& text) { text += 'd'; }); }, patient());
  ASSERT_TRUE(events->wait([](const auto& text) { return text.find('d') != std::string::npos; }));
  EXPECT_EQ(events->get(), "rd");
}

TEST(Query, AFailedGetThrowsAndCallsNothing) {
  Session session = lone_session();
  int calls = 0;
  EXPECT_THROW(session.get(
                   "test//a", [&](Reply&&) { ++calls; }, [&] { ++calls; }, GetOptions()),
               ZenohError);
  EXPECT_EQ(calls, 0);
}

TEST(Query, AnAnswerOutsideTheQueriedKeysIsRefused) {
  Session session = lone_session();
  auto refusal = std::make_shared<Watched<std::string>>();
  const auto queryable = session.declare_queryable("test/**", [refusal](Query&& query) {
    try {
      query.reply("elsewhere/a", Bytes::copy_of("x"));
    } catch (const ZenohError& error) {
      refusal->change([&](auto& text) { text = error.what(); });
    }
  });
  EXPECT_TRUE(session.get("test/a", patient()).empty());
  EXPECT_NE(refusal->get().find("elsewhere/a"), std::string::npos) << refusal->get();
}

}  // namespace
}  // namespace zloam::zenoh::test
