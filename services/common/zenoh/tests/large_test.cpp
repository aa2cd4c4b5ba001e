// Messages of 10 MB arrive whole, over TCP and in a get.
#include <gtest/gtest.h>

#include "common/zenoh/aligned.hpp"
#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

std::vector<std::uint8_t> pattern(std::size_t size, std::uint32_t seed) {
  std::vector<std::uint8_t> bytes(size);
  std::uint32_t state = seed;
  for (auto& byte : bytes) {
    state = state * 1664525u + 1013904223u;
    byte = static_cast<std::uint8_t>(state >> 24);
  }
  return bytes;
}

bool equal(const Bytes& bytes, const std::vector<std::uint8_t>& wanted) {
  const AlignedBytes view = view_aligned(bytes);
  return std::equal(view.data().begin(), view.data().end(), wanted.begin(), wanted.end());
}

constexpr std::size_t kSize = 10'000'000;

TEST(Large, TenMegabytesSeveralTimes) {
  Pair pair;
  Mailbox channel(pair.b, "test/a");
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  Publisher publisher = pair.a.declare_publisher("test/a", options);
  wait_matching(publisher);
  for (std::uint32_t i = 0; i < 5; ++i) {
    publisher.put(Bytes::own(pattern(kSize, i)));
    const auto sample = channel.recv(kPatience);
    ASSERT_TRUE(sample.has_value());
    EXPECT_TRUE(equal(sample->payload, pattern(kSize, i)));
  }
}

TEST(Large, AnAnswerOfTenMegabytes) {
  Session session = lone_session();
  const auto queryable = session.declare_queryable(
      "test/a", [](Query&& query) { query.reply(query.key(), Bytes::own(pattern(kSize, 7))); });
  GetOptions options;
  options.timeout = kPatience;
  const auto replies = session.get("test/a", options);
  ASSERT_EQ(replies.size(), 1u);
  ASSERT_TRUE(replies[0].ok());
  EXPECT_TRUE(equal(replies[0].sample->payload, pattern(kSize, 7)));
}

}  // namespace
}  // namespace zloam::zenoh::test
