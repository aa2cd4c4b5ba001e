// Published samples arrive with their payload and all their attributes.
#include <gtest/gtest.h>

#include <map>

#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

using Samples = Watched<std::vector<Sample>>;

auto store_in(const std::shared_ptr<Samples>& samples) {
  return [samples](Sample&& sample) {
    samples->change([&](auto& all) { all.push_back(std::move(sample)); });
  };
}

TEST(PubSub, CarriesPayloadAndEverythingBesideIt) {
  Pair pair;
  const auto samples = std::make_shared<Samples>();
  const auto subscriber = pair.b.declare_subscriber("test/**", store_in(samples));
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  options.priority = Priority::kInteractiveHigh;
  options.express = true;
  options.encoding = "application/x-flatbuffers;schema=sweep;major=1";
  Publisher publisher = pair.a.declare_publisher("test/a/b", options);
  EXPECT_EQ(publisher.key(), "test/a/b");
  wait_matching(publisher);
  EXPECT_TRUE(publisher.matching());
  publisher.put(Bytes::copy_of("hello"), Bytes::copy_of("beside"));

  ASSERT_TRUE(samples->wait([](const auto& all) { return all.size() == 1; }));
  const Sample sample = samples->get().front();
  EXPECT_EQ(sample.key, "test/a/b");
  EXPECT_EQ(sample.payload.to_string(), "hello");
  EXPECT_EQ(sample.attachment.to_string(), "beside");
  EXPECT_EQ(sample.encoding, options.encoding);
  EXPECT_EQ(sample.kind, SampleKind::kPut);
  EXPECT_EQ(sample.priority, Priority::kInteractiveHigh);
  EXPECT_EQ(sample.congestion_control, CongestionControl::kBlock);
  EXPECT_TRUE(sample.express);
}

TEST(PubSub, CarriesEachPriorityAndTheDefaults) {
  const std::vector<Priority> priorities{Priority::kRealTime,       Priority::kInteractiveHigh,
                                         Priority::kInteractiveLow, Priority::kDataHigh,
                                         Priority::kData,           Priority::kDataLow,
                                         Priority::kBackground};
  Pair pair;
  const auto samples = std::make_shared<Samples>();
  const auto subscriber = pair.b.declare_subscriber("test/*", store_in(samples));
  for (const Priority priority : priorities) {
    PublisherOptions options;
    options.priority = priority;
    Publisher publisher =
        pair.a.declare_publisher("test/" + std::to_string(static_cast<int>(priority)), options);
    wait_matching(publisher);
    publisher.put(Bytes::copy_of("x"));
  }
  ASSERT_TRUE(samples->wait([&](const auto& all) { return all.size() == priorities.size(); }));
  std::map<std::string, Priority> seen;
  for (const Sample& sample : samples->get()) {
    seen[sample.key] = sample.priority;
    EXPECT_EQ(sample.congestion_control, CongestionControl::kDrop);
    EXPECT_FALSE(sample.express);
    EXPECT_EQ(sample.attachment.size(), 0u);
  }
  for (const Priority priority : priorities) {
    EXPECT_EQ(seen.at("test/" + std::to_string(static_cast<int>(priority))), priority);
  }
}

TEST(PubSub, KeepsTheOrderOfOnePublisher) {
  Pair pair;
  const auto samples = std::make_shared<Samples>();
  const auto subscriber = pair.b.declare_subscriber("test/a", store_in(samples));
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  Publisher publisher = pair.a.declare_publisher("test/a", options);
  wait_matching(publisher);
  constexpr std::size_t kCount = 500;
  for (std::size_t i = 0; i < kCount; ++i) publisher.put(Bytes::copy_of(std::to_string(i)));
  ASSERT_TRUE(samples->wait([](const auto& all) { return all.size() == kCount; }));
  const auto all = samples->get();
  for (std::size_t i = 0; i < kCount; ++i) EXPECT_EQ(all[i].payload.to_string(), std::to_string(i));
}

TEST(PubSub, DeleteIsASampleOfItsOwnKind) {
  Session session = lone_session();
  const auto samples = std::make_shared<Samples>();
  const auto subscriber = session.declare_subscriber("test/*", store_in(samples));
  Publisher publisher = session.declare_publisher("test/a");
  publisher.delete_resource();
  session.delete_resource("test/b");
  ASSERT_TRUE(samples->wait([](const auto& all) { return all.size() == 2; }));
  for (const Sample& sample : samples->get()) {
    EXPECT_EQ(sample.kind, SampleKind::kDelete);
    EXPECT_EQ(sample.payload.size(), 0u);
  }
}

TEST(PubSub, PutWithoutAPublisherAndEmptyPayload) {
  Session session = lone_session();
  const auto samples = std::make_shared<Samples>();
  const auto subscriber = session.declare_subscriber("test/a", store_in(samples));
  PublisherOptions options;
  options.encoding = "text/plain";
  session.put("test/a", Bytes(), options);
  session.put("test/other", Bytes::copy_of("not for us"));
  session.put("test/a", Bytes::copy_of("second"), options);
  ASSERT_TRUE(samples->wait([](const auto& all) { return all.size() == 2; }));
  EXPECT_EQ(samples->get()[0].payload.size(), 0u);
  EXPECT_EQ(samples->get()[0].encoding, "text/plain");
  EXPECT_EQ(samples->get()[1].payload.to_string(), "second");
}

TEST(PubSub, ASessionKnowsTheOtherEndsOfItsLinks) {
  EXPECT_TRUE(lone_session().links().empty());
  const int port = free_port();
  Pair pair(port);
  Publisher publisher = pair.a.declare_publisher("test/a");
  const auto subscriber = pair.b.declare_subscriber("test/a", [](Sample&&) {});
  wait_matching(publisher);
  EXPECT_EQ(pair.b.links(), std::vector<std::string>{endpoint(port)});
  ASSERT_EQ(pair.a.links().size(), 1U);
  EXPECT_NE(pair.a.links().front(), endpoint(port));
  EXPECT_TRUE(pair.a.close(kPatience));
  for (int i = 0; i < 1000 && !pair.b.links().empty(); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  EXPECT_TRUE(pair.b.links().empty());
}

TEST(PubSub, SessionsHaveIds) {
  Pair pair;
  EXPECT_NE(pair.a.zid(), pair.b.zid());
  EXPECT_FALSE(pair.a.zid().empty());
  EXPECT_LE(pair.a.zid().size(), 32u);
  EXPECT_EQ(pair.a.zid().find_first_not_of("0123456789abcdef"), std::string::npos);
}

}  // namespace
}  // namespace zloam::zenoh::test
