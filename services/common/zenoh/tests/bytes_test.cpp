// Bytes: who owns them, when they are freed, when they are copied.
#include <gtest/gtest.h>

#include <numeric>
#include <thread>

#include "common/zenoh/aligned.hpp"
#include "common/zenoh/tests/support.hpp"

namespace zloam::zenoh::test {
namespace {

/// Counts how often it is destroyed while it owns something.
class Owner {
 public:
  Owner(std::size_t size, std::atomic<int>& deaths) : bytes_(size), deaths_(&deaths) {
    std::iota(bytes_.begin(), bytes_.end(), std::uint8_t{0});
  }
  Owner(Owner&& other) noexcept
      : bytes_(std::move(other.bytes_)), deaths_(std::exchange(other.deaths_, nullptr)) {}
  Owner& operator=(Owner&&) = delete;
  ~Owner() {
    if (deaths_ != nullptr) ++*deaths_;
  }
  const std::uint8_t* data() const { return bytes_.data(); }
  std::size_t size() const { return bytes_.size(); }

 private:
  std::vector<std::uint8_t> bytes_;
  std::atomic<int>* deaths_;
};

std::vector<std::uint8_t> pattern(std::size_t size) {
  std::vector<std::uint8_t> bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(i * 31 + (i >> 8));
  return bytes;
}

std::vector<std::uint8_t> all_of(const Bytes& bytes) {
  std::vector<std::uint8_t> copy(bytes.size());
  bytes.copy_to(copy.data());
  return copy;
}

TEST(Bytes, EmptyOnesAreContiguous) {
  for (const Bytes& bytes : {Bytes(), Bytes::copy_of(""), Bytes::own(std::vector<char>())}) {
    EXPECT_EQ(bytes.size(), 0u);
    ASSERT_TRUE(bytes.contiguous().has_value());
    EXPECT_TRUE(bytes.contiguous()->empty());
    EXPECT_EQ(bytes.to_string(), "");
    EXPECT_FALSE(bytes.is_shared_memory());
  }
}

TEST(Bytes, OwnedMemoryIsNotCopiedAndFreedOnce) {
  std::atomic<int> deaths{0};
  Owner owner(1000, deaths);
  const auto* data = owner.data();
  {
    Bytes bytes = Bytes::own(std::move(owner));
    const Bytes other = bytes;  // NOLINT(performance-unnecessary-copy-initialization)
    EXPECT_EQ(bytes.contiguous()->data(), data);
    EXPECT_EQ(other.contiguous()->data(), data);
    bytes = Bytes();
    EXPECT_EQ(deaths, 0);
    EXPECT_EQ(other.contiguous()->size(), 1000u);
  }
  EXPECT_EQ(deaths, 1);
}

TEST(Bytes, StayInPlaceWithinOneSession) {
  std::atomic<int> deaths{0};
  Owner owner(200'000, deaths);
  const auto* data = owner.data();
  {
    Session session = lone_session();
    Mailbox channel(session, "test/a", 4);
    session.put("test/a", Bytes::own(std::move(owner)));
    const auto sample = channel.recv(kPatience);
    ASSERT_TRUE(sample.has_value());
    ASSERT_TRUE(sample->payload.contiguous().has_value());
    EXPECT_EQ(sample->payload.contiguous()->data(), data);
    EXPECT_EQ(deaths, 0);
  }
  EXPECT_EQ(deaths, 1);
}

TEST(Bytes, OwnerIsFreedOnceThroughALinkAndWhenThePutFails) {
  std::atomic<int> deaths{0};
  {
    Pair pair;
    Mailbox channel(pair.b, "test/a");
    Publisher publisher = pair.a.declare_publisher("test/a");
    wait_matching(publisher);
    publisher.put(Bytes::own(Owner(5000, deaths)));
    ASSERT_TRUE(channel.recv(kPatience).has_value());
    ASSERT_TRUE(pair.a.close());
    EXPECT_THROW(publisher.put(Bytes::own(Owner(10, deaths))), ZenohError);
  }
  EXPECT_EQ(deaths, 2);
}

TEST(Bytes, FragmentsOfALargeMessageAreCopiedInOrder) {
  const auto sent = pattern(1'000'000);
  Pair pair;
  Mailbox channel(pair.b, "test/a");
  PublisherOptions options;
  options.congestion_control = CongestionControl::kBlock;
  Publisher publisher = pair.a.declare_publisher("test/a", options);
  wait_matching(publisher);
  publisher.put(Bytes::copy_of(sent));
  const auto sample = channel.recv(kPatience);
  ASSERT_TRUE(sample.has_value());
  ASSERT_EQ(sample->payload.size(), sent.size());
  EXPECT_FALSE(sample->payload.is_shared_memory());
  EXPECT_EQ(all_of(sample->payload), sent);

  TransferCounters counters;
  const AlignedBytes view = view_aligned(sample->payload, &counters);
  EXPECT_TRUE(std::equal(view.data().begin(), view.data().end(), sent.begin(), sent.end()));
  EXPECT_EQ(counters.bytes_copied + counters.bytes_in_place, sent.size());
  EXPECT_EQ(counters.messages_other, 1u);
}

TEST(AlignedBytes, ReadsAlignedBytesInPlaceAndCopiesOthers) {
  alignas(64) static std::array<std::uint8_t, 128> memory{};
  std::iota(memory.begin(), memory.end(), std::uint8_t{0});
  for (std::size_t offset = 0; offset < 17; ++offset) {
    const Bytes bytes = Bytes::own(std::span<const std::uint8_t>(memory).subspan(offset, 100));
    TransferCounters counters;
    const AlignedBytes view = view_aligned(bytes, &counters);
    const bool aligned = offset % 8 == 0;
    EXPECT_EQ(view.in_place(), aligned) << offset;
    EXPECT_EQ(counters.bytes_in_place, aligned ? 100u : 0u);
    EXPECT_EQ(counters.bytes_copied, aligned ? 0u : 100u);
    const auto address = reinterpret_cast<std::uintptr_t>(view.data().data());
    EXPECT_EQ(address % (aligned ? kInPlaceAlignment : kCopyAlignment), 0u);
    EXPECT_TRUE(std::equal(view.data().begin(), view.data().end(), memory.begin() + offset));
    EXPECT_EQ(view.size(), 100u);
  }
}

TEST(AlignedBytes, WhatIsKeptSharesACopyAndHoldsNoReceiveBuffer) {
  std::atomic<int> deaths{0};
  for (const bool in_place : {true, false}) {
    Bytes kept;
    const std::uint8_t* read_at = nullptr;
    {
      Bytes payload = Bytes::own(Owner(64, deaths));
      if (!in_place) payload = payload.in_parts(7);
      const AlignedBytes view = view_aligned(std::move(payload));
      ASSERT_EQ(view.in_place(), in_place);
      read_at = view.data().data();
      kept = view.to_keep();
    }
    EXPECT_EQ(deaths, in_place ? 1 : 2);
    ASSERT_TRUE(kept.contiguous().has_value());
    EXPECT_EQ(kept.contiguous()->data() == read_at, !in_place);
    EXPECT_EQ(kept.size(), 64u);
    EXPECT_EQ((*kept.contiguous())[63], 63);
  }
}

TEST(AlignedBytes, KeepTheirBytesAlive) {
  std::atomic<int> deaths{0};
  {
    AlignedBytes view;
    view = view_aligned(Bytes::own(Owner(64, deaths)));
    EXPECT_EQ(deaths, view.in_place() ? 0 : 1);
    EXPECT_EQ(view.data()[63], 63);
  }
  EXPECT_EQ(deaths, 1);
  EXPECT_EQ(view_aligned(Bytes()).size(), 0u);
}

}  // namespace
}  // namespace zloam::zenoh::test
