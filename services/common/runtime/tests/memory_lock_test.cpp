// When shared memory is turned off because it could not be locked or has no room.

#include "common/runtime/memory_lock.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace zloam::runtime {
namespace {

constexpr std::uint64_t kMib = std::uint64_t{1} << 20;

TEST(MemoryLock, TheCapabilityLiftsTheLimit) {
  // Bit 14 is CAP_IPC_LOCK (capabilities(7)).
  EXPECT_EQ(lockable_bytes("Name:\tx\nCapEff:\t0000000000004000\n", 8 * kMib), kUnlimited);
  EXPECT_EQ(lockable_bytes("Name:\tx\nCapEff:\t000001ffffffbfff\n", 8 * kMib), 8 * kMib);
  EXPECT_EQ(lockable_bytes("", 8 * kMib), 8 * kMib);
}

TEST(MemoryLock, AStageLocksThePoolsOfTheOthersToo) {
  EXPECT_TRUE(pools_fit(kUnlimited, 4096));
  EXPECT_TRUE(pools_fit(28 * kMib, 4));  // five that are read, the store, one's own
  EXPECT_FALSE(pools_fit(28 * kMib - 1, 4));
  EXPECT_FALSE(pools_fit(8 * kMib, 4));
}

TEST(MemoryLock, PoolsNeedAPlace) {
  const std::string folder = testing::TempDir();
  EXPECT_EQ(no_place_for_pools(folder, 1), "");
  // 1 PiB per program: more than any disk has.
  EXPECT_THAT(no_place_for_pools(folder, 1 << 30), testing::HasSubstr(folder));
  EXPECT_THAT(no_place_for_pools("/nowhere", 1), testing::HasSubstr("/nowhere: No such file"));
}

}  // namespace
}  // namespace zloam::runtime
