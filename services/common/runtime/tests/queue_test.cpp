#include "common/runtime/queue.hpp"

#include <gtest/gtest.h>

#include <thread>

namespace zloam::runtime {
namespace {

TEST(BoundedQueue, NewestDropsTheOldest) {
  BoundedQueue<int> q({QueuePolicy::kNewest, 3, 1000});
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(q.push(i, 1).empty());
  EXPECT_EQ(q.push(3, 1), std::vector<int>{0});
  EXPECT_EQ(q.pop(), 1);
  EXPECT_EQ(q.pop(), 2);
  EXPECT_EQ(q.pop(), 3);
  EXPECT_EQ(q.pop(), std::nullopt);
}

TEST(BoundedQueue, LosslessRefusesTheNewcomer) {
  BoundedQueue<int> q({QueuePolicy::kLossless, 2, 1000});
  q.push(0, 1);
  q.push(1, 1);
  EXPECT_EQ(q.push(2, 1), std::vector<int>{2});
  EXPECT_EQ(q.pop(), 0);
}

TEST(BoundedQueue, BytesBoundBothPolicies) {
  BoundedQueue<int> newest({QueuePolicy::kNewest, 100, 10});
  newest.push(0, 4);
  newest.push(1, 4);
  EXPECT_EQ(newest.push(2, 8), (std::vector<int>{0, 1}));
  EXPECT_EQ(newest.bytes(), 8U);
  // Larger than the bound: dropped itself, and nothing else for its sake.
  EXPECT_EQ(newest.push(3, 11), std::vector<int>{3});
  EXPECT_EQ(newest.pop(), 2);
  BoundedQueue<int> lossless({QueuePolicy::kLossless, 100, 10});
  lossless.push(0, 6);
  EXPECT_EQ(lossless.push(1, 5), std::vector<int>{1});
}

TEST(BoundedQueue, NothingIsLostOrDoubledBetweenThreads) {
  BoundedQueue<int> q({QueuePolicy::kNewest, 16, 1 << 20});
  constexpr int kItems = 20000;
  std::size_t dropped = 0;
  std::thread writer([&] {
    for (int i = 0; i < kItems; ++i) dropped += q.push(i, 8).size();
  });
  std::size_t taken = 0;
  int last = -1;
  const auto take = [&] {
    const auto item = q.pop();
    if (!item) return false;
    EXPECT_GT(*item, last);
    last = *item;
    ++taken;
    return true;
  };
  for (int spins = 0; spins < 100000; ++spins) take();
  writer.join();
  while (take()) {
  }
  EXPECT_EQ(taken + dropped, static_cast<std::size_t>(kItems));
  EXPECT_EQ(last, kItems - 1);
}

}  // namespace
}  // namespace zloam::runtime
