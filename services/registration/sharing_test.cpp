// Which replica computes which sweep: the hash against its author's vectors, the division against
// the properties of rendezvous hashing, and the buffer of held sweeps against examples.

#include "registration/sharing.hpp"

#include <gtest/gtest.h>

#include <map>
#include <set>

namespace zloam::registration {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::uint64_t kRun = 77;
constexpr std::size_t kSweepBytes = 1000;

/// The buffer of xxHash's own self-test.
std::string sanity_buffer(std::size_t size) {
  std::string bytes(size, '\0');
  std::uint32_t state = 2654435761U;
  for (char& byte : bytes) {
    byte = static_cast<char>(state >> 24U);
    state *= state;
  }
  return bytes;
}

std::uint64_t weight_of_text(const std::string& text, std::uint64_t seed) {
  std::uint64_t sweep = 0;
  for (std::size_t i = 0; i < 8; ++i) {
    sweep |= std::uint64_t{static_cast<unsigned char>(text[i])} << (8 * i);
  }
  return weight(seed, sweep, text.substr(8));
}

TEST(Weight, IsXxh64OfTheNumberAndTheName) {
  // xxHash's self-test: 14 and 101 bytes, with seed 0 and with its prime as the seed.
  EXPECT_EQ(weight_of_text(sanity_buffer(14), 0), 0xCFFA8DB881BC3A3DU);
  EXPECT_EQ(weight_of_text(sanity_buffer(14), 2654435761U), 0x5B9611585EFCC9CBU);
  EXPECT_EQ(weight_of_text(sanity_buffer(101), 0), 0x0EAB543384F878ADU);
  EXPECT_EQ(weight_of_text(sanity_buffer(101), 2654435761U), 0xCAA65939306F1E21U);
}

TEST(Rank, IsAPermutationOfTheMembersForEverySweep) {
  const std::vector<std::string> members = {"a", "b", "c", "d"};
  for (std::uint64_t n = 0; n < 200; ++n) {
    std::set<std::size_t> ranks;
    for (const auto& m : members) ranks.insert(rank(kRun, n, m, members));
    EXPECT_EQ(ranks, (std::set<std::size_t>{0, 1, 2, 3})) << n;
  }
}

TEST(Rank, DividesEvenly) {
  const std::vector<std::string> members = {"a", "b", "c"};
  std::map<std::string, int> share;
  for (std::uint64_t n = 0; n < 3000; ++n) {
    for (const auto& m : members) share[m] += rank(kRun, n, m, members) == 0 ? 1 : 0;
  }
  // Binomial distribution with p = 1/3: the standard deviation is 26.
  for (const auto& m : members) EXPECT_NEAR(share[m], 1000, 5 * 26) << m;
}

TEST(Rank, WhoGoesLeavesOnlyItsOwnSweeps) {
  const std::vector<std::string> three = {"a", "b", "c"};
  const std::vector<std::string> two = {"a", "b"};
  int moved = 0;
  for (std::uint64_t n = 0; n < 500; ++n) {
    if (rank(kRun, n, "c", three) == 0) {
      ++moved;
      continue;
    }
    EXPECT_EQ(rank(kRun, n, "a", three) == 0, rank(kRun, n, "a", two) == 0) << n;
  }
  EXPECT_GT(moved, 0);
}

TEST(Rank, ItselfNeedNotBeListedAndAloneIsFirst) {
  EXPECT_EQ(rank(kRun, 5, "a", {}), 0U);
  EXPECT_EQ(rank(kRun, 5, "a", {"a"}), 0U);
  EXPECT_EQ(rank(kRun, 5, "a", {"a", "b"}), rank(kRun, 5, "a", {"b"}));
}

/// The first sweep from n on for which the instance has this rank among the members.
std::uint64_t with_rank(std::size_t place, std::uint64_t n, const std::string& instance,
                        const std::vector<std::string>& members) {
  while (rank(kRun, n, instance, members) != place) ++n;
  return n;
}

class SharingTest : public ::testing::Test {
 protected:
  Sharing::Share take(std::uint64_t n, std::int64_t at_ms, bool replay = true) {
    return sharing_.take({kRun, n, replay, kSweepBytes}, at_ms * kMs);
  }
  std::vector<std::uint64_t> due(std::int64_t at_ms, bool compute) {
    std::vector<std::uint64_t> sweeps;
    for (const auto& d : sharing_.due(at_ms * kMs)) {
      EXPECT_EQ(d.compute, compute) << d.sweep;
      sweeps.push_back(d.sweep);
    }
    return sweeps;
  }
  using Sweeps = std::vector<std::uint64_t>;

  std::vector<std::string> all_ = {"a", "b", "c"};
  Sharing sharing_{"a", {.redo_live_ms = 40, .redo_replay_ms = 500, .hold_sweeps = 4}};
};

TEST_F(SharingTest, AloneComputesAtOnceAndHoldsNothing) {
  for (std::uint64_t n = 0; n < 20; ++n) EXPECT_EQ(take(n, 0), Sharing::Share::kCompute);
  EXPECT_EQ(sharing_.held(), 0U);
}

TEST_F(SharingTest, WhatOthersComputeIsHeldUntilOdometryIsPastIt) {
  sharing_.set_members(all_);
  const std::uint64_t n = with_rank(1, 10, "a", all_);
  EXPECT_EQ(take(n, 0), Sharing::Share::kHold);
  EXPECT_EQ(due(499, true), Sweeps{});
  sharing_.set_progress({kRun, n, n, {}});
  EXPECT_EQ(due(499, true), Sweeps{});
  sharing_.set_progress({kRun, n + 1, n + 1, {}});
  EXPECT_EQ(due(499, false), Sweeps{n});
  EXPECT_EQ(sharing_.held(), 0U);
}

TEST_F(SharingTest, TheNextInRankDoesAgainWhatIsMissing) {
  sharing_.set_members(all_);
  const std::uint64_t second = with_rank(1, 10, "a", all_);
  const std::uint64_t third = with_rank(2, second + 1, "a", all_);
  take(second, 0);
  take(third, 0);
  EXPECT_EQ(due(499, true), Sweeps{});
  EXPECT_EQ(due(500, true), Sweeps{second});
  EXPECT_EQ(due(999, true), Sweeps{});
  EXPECT_EQ(due(1000, true), Sweeps{third});
}

TEST_F(SharingTest, LiveItIsDoneAgainSooner) {
  sharing_.set_members(all_);
  const std::uint64_t n = with_rank(1, 10, "a", all_);
  take(n, 0, false);
  EXPECT_EQ(due(39, true), Sweeps{});
  EXPECT_EQ(due(40, true), Sweeps{n});
}

TEST_F(SharingTest, WhatOdometryHasButHasNotComeToIsNotDoneAgain) {
  sharing_.set_members(all_);
  const std::uint64_t n = with_rank(1, 10, "a", all_);
  take(n, 0);
  sharing_.set_progress({kRun, n - 1, n + 2, {n - 1}});
  EXPECT_EQ(due(5000, true), Sweeps{});
  // If odometry then reports it as missing, it is computed.
  sharing_.set_progress({kRun, n - 1, n + 2, {n - 1, n}});
  EXPECT_EQ(due(5000, true), Sweeps{n});
}

TEST_F(SharingTest, WhoBecomesFirstComputesWhatItHolds) {
  sharing_.set_members(all_);
  const std::uint64_t n = with_rank(1, 10, "a", all_);
  take(n, 0);
  sharing_.set_members({"a"});
  EXPECT_EQ(due(0, true), Sweeps{n});
}

TEST_F(SharingTest, WhatIsDoneIsNobodysAndAnotherRunsProgressSaysNothing) {
  sharing_.set_progress({kRun, 10, 10, {}});
  EXPECT_EQ(take(9, 0), Sharing::Share::kNotMine);
  EXPECT_EQ(take(10, 0), Sharing::Share::kCompute);
  sharing_.set_progress({kRun + 1, 100, 100, {}});
  EXPECT_EQ(take(11, 0), Sharing::Share::kCompute);
}

TEST_F(SharingTest, TheBoundLetsTheOldestGo) {
  sharing_.set_members(all_);
  for (const bool replay : {true, false}) {
    Sweeps held;
    std::uint64_t n = replay ? 10 : 1000;
    while (held.size() < 5) {
      n = with_rank(1, n + 1, "a", all_);
      take(n, 0, replay);
      held.push_back(n);
    }
    // In a replay the oldest sweep is computed; in a live run it is dropped.
    EXPECT_EQ(due(0, replay), Sweeps{held.front()});
    EXPECT_EQ(sharing_.held(), 4U);
    sharing_.set_progress({kRun, n + 1, n + 1, {}});
    EXPECT_EQ(due(0, false).size(), 4U);
  }
}

TEST_F(SharingTest, BytesAreBoundedToo) {
  Sharing sharing("a", {.hold_mib = 1});
  sharing.set_members(all_);
  std::uint64_t n = 0;
  for (int i = 0; i < 3; ++i) {
    n = with_rank(1, n + 1, "a", all_);
    sharing.take({kRun, n, false, 600'000}, 0);
  }
  EXPECT_EQ(sharing.due(0).size(), 2U);
  EXPECT_EQ(sharing.held(), 1U);
}

TEST_F(SharingTest, ANewRunEndsTheOldOnesSweeps) {
  sharing_.set_members(all_);
  const std::uint64_t n = with_rank(1, 10, "a", all_);
  take(n, 0);
  std::uint64_t m = 0;
  while (rank(kRun + 1, m, "a", all_) != 0) ++m;
  EXPECT_EQ(sharing_.take({kRun + 1, m, true, kSweepBytes}, 0), Sharing::Share::kCompute);
  EXPECT_EQ(due(0, false), Sweeps{n});
}

}  // namespace
}  // namespace zloam::registration
