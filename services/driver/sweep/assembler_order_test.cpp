// Lost, late, duplicate and reordered packets.
#include <gtest/gtest.h>

#include <algorithm>

#include "driver/sweep/test_sweeps.hpp"

namespace zloam::driver {
namespace {

using test::assemble;
using test::expect_in_time_order;
using test::expect_same;
using test::packets_of;
using test::Payload;
using test::TurningSensor;

TEST(Assembler, LostPacketsAreCountedAndFlagTheSweep) {
  TurningSensor sensor;
  std::vector<Payload> packets = packets_of(sensor, 400);
  std::vector<Payload> kept;
  for (std::size_t i = 0; i < packets.size(); ++i) {
    if (i % 7 != 3) kept.push_back(packets[i]);
  }
  PacketCounts counts;
  const auto sweeps = assemble(kept, {}, &counts);
  EXPECT_EQ(counts.lost, packets.size() - kept.size());
  EXPECT_EQ(counts.decoded, kept.size());
  expect_in_time_order(sweeps);
  std::uint32_t lost = 0;
  for (std::size_t i = 1; i + 1 < sweeps.size(); ++i) {
    EXPECT_FALSE(sweeps[i].complete);
    EXPECT_NEAR(sweeps[i].period_ns, 1e8, 2e4);
    lost += sweeps[i].packets_lost;
  }
  EXPECT_GT(lost, 0U);
}

/// Without the packets that begin within these degrees, counted from the first packet on.
std::vector<DecodedSweep> without(double from_deg, double to_deg) {
  constexpr double kPacketDeg = 6.0 * 600.0 * 12 * 110.592e-6;
  TurningSensor sensor;
  std::vector<Payload> kept;
  for (int i = 0; i < 500; ++i) {
    const Payload packet = sensor.next();
    if (kPacketDeg * i < from_deg || kPacketDeg * i >= to_deg) kept.push_back(packet);
  }
  return assemble(kept);
}

TEST(Assembler, BothSweepsThatLackPacketsAtTheSeamSaySo) {
  // 60 degrees on either side of the fourth turn's beginning.
  auto sweeps = without(1020.0, 1140.0);
  ASSERT_GT(sweeps.size(), 5U);
  EXPECT_FALSE(sweeps[2].complete);
  EXPECT_FALSE(sweeps[3].complete);
  EXPECT_TRUE(sweeps[4].complete);
  // 4.78 degrees a packet; the one across the seam belongs to both.
  EXPECT_NEAR(sweeps[2].packets_lost, 13.0, 1.0);
  EXPECT_NEAR(sweeps[3].packets_lost, 13.0, 1.0);
  // 460 degrees, from 100 degrees after the seam to 200 degrees after the next one.
  sweeps = without(820.0, 1280.0);
  ASSERT_GT(sweeps.size(), 5U);
  EXPECT_FALSE(sweeps[2].complete);
  EXPECT_FALSE(sweeps[3].complete);
  EXPECT_TRUE(sweeps[4].complete);
  EXPECT_NEAR(sweeps[3].packets_lost, 200.0 / 4.78, 1.5);
}

constexpr int kPacketsATurn = 75;
constexpr std::size_t kLostATurn = 5;

/// The sensor begins each revolution with a packet: the same 24 degrees are lost in these turns.
PacketCounts without_a_sector_in(const std::vector<int>& turns) {
  TurningSensor sensor;
  sensor.rpm = 1e6 * 60.0 / (kPacketsATurn * 12 * sensor.group_us);
  std::vector<Payload> kept;
  for (int i = 0; i < 20 * kPacketsATurn; ++i) {
    const Payload packet = sensor.next();
    const bool lossy = std::count(turns.begin(), turns.end(), i / kPacketsATurn) > 0;
    const int in_turn = i % kPacketsATurn;
    if (!lossy || in_turn < 20 || in_turn >= 25) kept.push_back(packet);
  }
  PacketCounts counts;
  assemble(kept, {}, &counts);
  return counts;
}

TEST(Assembler, LossesAtTheSameAzimuthsAreNoViewsGap) {
  const std::vector<std::vector<int>> cases = {{3, 10}, {3, 4, 5}, {3, 5, 7, 9, 11, 13}};
  for (const std::vector<int>& turns : cases) {
    SCOPED_TRACE(turns.size());
    EXPECT_EQ(without_a_sector_in(turns).lost, turns.size() * kLostATurn);
  }
}

TEST(Assembler, ASectorThatIsSeenIsNoLongerAViewsGap) {
  const std::uint64_t habit = without_a_sector_in({3, 4, 5, 6, 7, 8}).lost;
  EXPECT_LT(habit, 6 * kLostATurn) << "taken as a view's gap, or this test shows nothing";
  EXPECT_EQ(without_a_sector_in({3, 4, 5, 6, 7, 8, 12}).lost, habit + kLostATurn);
}

TEST(Assembler, ALossBeforeTheSeamIsNoneOfTheNextSweep) {
  const auto sweeps = without(1020.0, 1070.0);
  ASSERT_GT(sweeps.size(), 4U);
  EXPECT_FALSE(sweeps[2].complete);
  EXPECT_NEAR(sweeps[2].packets_lost, 10.5, 1.0);
  EXPECT_TRUE(sweeps[3].complete);
  EXPECT_EQ(sweeps[3].packets_lost, 0U);
}

TEST(Assembler, ALostPacketDoesNotMoveThePointsOfOthers) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 40);
  std::vector<Payload> kept = packets;
  kept.erase(kept.begin() + 20);
  const auto whole = assemble(packets);
  const auto gap = assemble(kept);
  ASSERT_EQ(whole.size(), gap.size());
  ASSERT_EQ(gap[0].points.size() + 384, whole[0].points.size());
  for (std::size_t i = 0; i < gap[0].points.size(); ++i) {
    const Point& a = gap[0].points[i];
    const Point& b = whole[0].points[i < 20 * 384 ? i : i + 384];
    ASSERT_EQ(a.x, b.x);
    ASSERT_EQ(a.time_ns, b.time_ns);
    ASSERT_EQ(gap[0].columns[i], whole[0].columns[i < 20 * 384 ? i : i + 384]);
  }
}

TEST(Assembler, SwappedNeighboursGiveTheSameSweeps) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 300);
  std::vector<Payload> swapped = packets;
  for (std::size_t i = 0; i + 1 < swapped.size(); i += 2) std::swap(swapped[i], swapped[i + 1]);
  PacketCounts counts;
  const auto expected = assemble(packets);
  const auto got = assemble(swapped, {}, &counts);
  EXPECT_EQ(counts.lost, 0U);
  EXPECT_EQ(counts.late, 0U);
  EXPECT_GT(counts.reordered, 100U);
  expect_same(got, expected);
}

TEST(Assembler, DuplicatesAndVeryLatePacketsAreDroppedByName) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 100);
  std::vector<Payload> stream;
  for (const Payload& packet : packets) {
    stream.push_back(packet);
    stream.push_back(packet);
  }
  PacketCounts counts;
  const auto sweeps = assemble(stream, {}, &counts);
  EXPECT_EQ(counts.duplicate, 100U);
  EXPECT_EQ(counts.points, 100U * 384U);
  EXPECT_EQ(sweeps.size(), assemble(packets).size());

  std::vector<Payload> late = packets;
  const Payload moved = late[10];
  late.erase(late.begin() + 10);
  late.insert(late.begin() + 60, moved);
  assemble(late, {}, &counts);
  EXPECT_EQ(counts.late, 1U);
  EXPECT_EQ(counts.lost, 0U) << "it came, only too late";
}

TEST(Assembler, ALateCopyIsACopyAndALatePacketIsNotLost) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 200);
  std::vector<Payload> stream = packets;
  stream.insert(stream.begin() + 60, packets[10]);
  PacketCounts counts;
  assemble(stream, {}, &counts);
  EXPECT_EQ(counts.duplicate, 1U);
  EXPECT_EQ(counts.late, 0U);

  // Later than the window: its points are dropped, but it does not count as lost.
  stream = packets;
  stream.erase(stream.begin() + 10);
  stream.erase(stream.begin() + 50);
  stream.insert(stream.begin() + 60, packets[10]);
  assemble(stream, {}, &counts);
  EXPECT_EQ(counts.late, 1U);
  EXPECT_EQ(counts.lost, 1U) << "packet 51 only";
}

TEST(Assembler, ALatePacketWithinTheWindowIsInsertedByTime) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 300);
  std::vector<Payload> stream;
  std::size_t moved = 0;
  for (std::size_t i = 0; i < packets.size(); ++i) {
    if (i % 20 == 5 && i + 3 < packets.size()) {
      for (std::size_t k = 1; k <= 3; ++k) stream.push_back(packets[i + k]);
      stream.push_back(packets[i]);
      i += 3;
      ++moved;
    } else {
      stream.push_back(packets[i]);
    }
  }
  PacketCounts counts;
  const auto expected = assemble(packets);
  const auto got = assemble(stream, {}, &counts);
  EXPECT_EQ(counts.reordered, moved);
  EXPECT_EQ(counts.late, 0U);
  EXPECT_EQ(counts.lost, 0U);
  expect_same(got, expected);
}

}  // namespace
}  // namespace zloam::driver
