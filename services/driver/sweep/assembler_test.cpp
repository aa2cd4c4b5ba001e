#include "driver/sweep/assembler.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver {
namespace {

using test::Payload;
using test::TurningSensor;

std::vector<Payload> packets_of(TurningSensor& sensor, int count) {
  std::vector<Payload> packets;
  for (int i = 0; i < count; ++i) packets.push_back(sensor.next());
  return packets;
}

std::vector<DecodedSweep> sweeps_of(SweepAssembler& assembler) {
  std::vector<DecodedSweep> sweeps;
  DecodedSweep sweep;
  while (assembler.take(sweep)) sweeps.push_back(sweep);
  return sweeps;
}

std::vector<DecodedSweep> assemble(const std::vector<Payload>& packets, AssemblerConfig config = {},
                                   PacketCounts* counts = nullptr) {
  SweepAssembler assembler({}, config);
  for (const Payload& packet : packets) assembler.add(packet, 0);
  assembler.flush();
  if (counts) *counts = assembler.counts();
  return sweeps_of(assembler);
}

double azimuth_deg(const Point& p) {
  const double deg = std::atan2(-p.y, p.x) * 180.0 / M_PI;
  return deg < 0.0 ? deg + 360.0 : deg;
}

void expect_in_time_order(const std::vector<DecodedSweep>& sweeps) {
  std::int64_t last_ns = std::numeric_limits<std::int64_t>::min();
  for (const DecodedSweep& sweep : sweeps) {
    ASSERT_EQ(sweep.points.size(), sweep.columns.size());
    for (const Point& p : sweep.points) {
      ASSERT_GE(sweep.stamp_ns + p.time_ns, last_ns);
      last_ns = sweep.stamp_ns + p.time_ns;
    }
  }
}

TEST(Assembler, CutsEveryTurnAtTheSeam) {
  TurningSensor sensor;
  sensor.azimuth_deg = 200.0;
  const auto sweeps = assemble(packets_of(sensor, 400), {.seam_azimuth_deg = 90.0});
  ASSERT_EQ(sweeps.size(), 6U);
  expect_in_time_order(sweeps);
  EXPECT_FALSE(sweeps.front().complete);
  EXPECT_FALSE(sweeps.back().complete);
  for (std::size_t i = 1; i + 1 < sweeps.size(); ++i) {
    SCOPED_TRACE(i);
    const DecodedSweep& sweep = sweeps[i];
    EXPECT_TRUE(sweep.complete);
    EXPECT_EQ(sweep.points.front().time_ns, 0U);
    EXPECT_NEAR(sweep.period_ns, 1e8, 2e4);
    EXPECT_NEAR(azimuth_deg(sweep.points.front()), 90.3, 0.5);
    EXPECT_NEAR(azimuth_deg(sweep.points.back()), 90.3, 0.5);
    EXPECT_EQ(sweep.rings, 16);
    EXPECT_EQ(sweep.model, "vlp16");
    // 1808.4 firings of 16 lasers in a turn, in whole groups of two.
    EXPECT_NEAR(static_cast<double>(sweep.points.size()), 1808.4 * 16, 33.0);
    EXPECT_EQ(sweep.columns.front(), 0);
    EXPECT_NEAR(sweep.columns.back(), 1807, 2);
    if (i > 1) {
      EXPECT_NEAR(static_cast<double>(sweep.stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 1.2e5);
    }
  }
}

TEST(Assembler, EveryPointIsInExactlyOneSweep) {
  TurningSensor sensor;
  const auto sweeps = assemble(packets_of(sensor, 300));
  std::size_t points = 0;
  std::uint32_t packets = 0;
  for (const DecodedSweep& sweep : sweeps) {
    points += sweep.points.size();
    packets += sweep.packets;
  }
  EXPECT_EQ(points, 300U * 384U);
  EXPECT_GE(packets, 300U);
  EXPECT_LE(packets, 300U + sweeps.size());
}

TEST(Assembler, ColumnsAreTheFirings) {
  TurningSensor sensor;
  for (const DecodedSweep& sweep : assemble(packets_of(sensor, 200))) {
    for (std::size_t i = 0; i < sweep.points.size(); ++i) {
      ASSERT_EQ(sweep.columns[i], i / 16);
    }
  }
}

TEST(Assembler, AcceptsAllLengthsButDecodesOnlyItsOwn) {
  TurningSensor sensor;
  SweepAssembler assembler({}, {});
  const Payload good = sensor.next();
  const std::vector<std::uint8_t> long_one(1207, 0);
  assembler.add(std::span(good).first(1205), 0);
  assembler.add(long_one, 0);
  assembler.add({}, 0);
  assembler.add(good, 0);
  assembler.flush();
  EXPECT_EQ(assembler.counts().received, 4U);
  EXPECT_EQ(assembler.counts().too_short, 1U);
  EXPECT_EQ(assembler.counts().foreign, 2U);
  EXPECT_EQ(assembler.counts().decoded, 1U);
}

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
  ASSERT_EQ(got.size(), expected.size());
  for (std::size_t s = 0; s < got.size(); ++s) {
    ASSERT_EQ(got[s].points.size(), expected[s].points.size());
    EXPECT_EQ(got[s].stamp_ns, expected[s].stamp_ns);
    EXPECT_EQ(got[s].complete, expected[s].complete);
    for (std::size_t i = 0; i < got[s].points.size(); ++i) {
      ASSERT_EQ(got[s].points[i].x, expected[s].points[i].x);
      ASSERT_EQ(got[s].points[i].time_ns, expected[s].points[i].time_ns);
    }
  }
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

  // Later than the window: its points are gone, but it came.
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
  ASSERT_EQ(got.size(), expected.size());
  for (std::size_t s = 0; s < got.size(); ++s) {
    ASSERT_EQ(got[s].points.size(), expected[s].points.size());
    EXPECT_EQ(got[s].complete, expected[s].complete);
    for (std::size_t i = 0; i < got[s].points.size(); ++i) {
      ASSERT_EQ(got[s].points[i].x, expected[s].points[i].x);
      ASSERT_EQ(got[s].points[i].time_ns, expected[s].points[i].time_ns);
    }
  }
}

TEST(Assembler, OneStampFromElsewhereIsNoStep) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 200);
  std::vector<Payload> stream = packets;
  // 500 s before.
  stream[100][1203] = static_cast<std::uint8_t>(stream[100][1203] ^ 0x1d);
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (const Payload& packet : stream) assembler.add(packet, received_ns += 1'327'104);
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 0U);
  EXPECT_EQ(assembler.counts().late, 1U);
  EXPECT_EQ(assembler.counts().lost, 1U) << "its place stays empty";
  EXPECT_EQ(assembler.counts().decoded, 199U);
}

TEST(Assembler, APacketFromBeforeTheStepComesLate) {
  TurningSensor sensor;
  std::vector<Payload> stream = packets_of(sensor, 150);
  const Payload late = stream[148];
  stream.erase(stream.begin() + 148);
  sensor.time_us += 60e6;
  for (const Payload& packet : packets_of(sensor, 150)) stream.push_back(packet);
  stream.insert(stream.begin() + 151, late);
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (const Payload& packet : stream) assembler.add(packet, received_ns += 1'327'104);
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 1U);
  EXPECT_EQ(assembler.counts().late, 1U);
  EXPECT_EQ(assembler.counts().decoded, 299U);
}

TEST(Assembler, ASmallStepBackIsKnownByItsManyLatePackets) {
  TurningSensor sensor;
  std::vector<Payload> stream = packets_of(sensor, 150);
  sensor.time_us -= 200'300.0;
  for (const Payload& packet : packets_of(sensor, 300)) stream.push_back(packet);
  PacketCounts counts;
  const auto sweeps = assemble(stream, {}, &counts);
  EXPECT_EQ(counts.clock_steps, 1U);
  EXPECT_LE(counts.late, 16U);
  EXPECT_GE(counts.decoded, 434U);
  expect_in_time_order(sweeps);
}

TEST(Assembler, EightThousandSecondsGoOnOverTwoHours) {
  TurningSensor sensor;
  sensor.time_us = 3'000'000'000.0;
  SweepAssembler assembler({}, {.clock_mode = ClockMode::kUtc});
  // A packet each 0.9 s is enough. 1700002800 is a full hour.
  const std::int64_t start_ns = (1'700'002'800 + 3000) * 1'000'000'000LL;
  constexpr std::int64_t kStepNs = 900'000'000;
  constexpr std::int64_t kPackets = 8900;
  std::int64_t last = -1;
  DecodedSweep sweep;
  const auto check = [&] {
    // A packet over the seam makes two sweeps.
    while (assembler.take(sweep)) {
      const std::int64_t after_ns = sweep.stamp_ns - start_ns;
      ASSERT_LT(after_ns % kStepNs, 1'327'104);
      ASSERT_LE(after_ns / kStepNs - last, 1);
      last = after_ns / kStepNs;
    }
  };
  for (std::int64_t i = 0; i < kPackets; ++i) {
    sensor.time_us = 3e9 + 9e5 * static_cast<double>(i);
    assembler.add(sensor.next(), start_ns + kStepNs * i + 1'400'000);
    check();
  }
  assembler.flush();
  check();
  EXPECT_EQ(assembler.counts().clock_steps, 0U);
  EXPECT_EQ(last, kPackets - 1);
}

TEST(Assembler, AnOffsetShiftsEveryStamp) {
  TurningSensor sensor;
  const auto packets = packets_of(sensor, 200);
  const auto plain = assemble(packets);
  const auto shifted = assemble(packets, {.stamp_offset_ns = -542'592});
  ASSERT_EQ(plain.size(), shifted.size());
  for (std::size_t i = 0; i < plain.size(); ++i) {
    EXPECT_EQ(shifted[i].stamp_ns, plain[i].stamp_ns - 542'592);
  }
}

TEST(Assembler, DualReturnHasAsManySweeps) {
  std::array<std::size_t, 2> sweeps{};
  for (const bool dual : {false, true}) {
    TurningSensor sensor;
    if (dual) sensor.mode = 0x39;
    sweeps[dual] = assemble(packets_of(sensor, dual ? 600 : 300)).size();
  }
  EXPECT_EQ(sweeps[0], 4U);
  EXPECT_EQ(sweeps[1], 4U);
}

TEST(Assembler, ATurnWithoutReturnsIsEmptyAndWhole) {
  TurningSensor sensor;
  std::vector<Payload> packets = packets_of(sensor, 100);
  sensor.raw_distance = 0;
  for (const Payload& packet : packets_of(sensor, 200)) packets.push_back(packet);
  const auto sweeps = assemble(packets);
  ASSERT_GT(sweeps.size(), 3U);
  EXPECT_TRUE(sweeps[2].points.empty());
  EXPECT_TRUE(sweeps[2].columns.empty());
  EXPECT_TRUE(sweeps[2].complete);
  EXPECT_NEAR(sweeps[2].period_ns, 1e8, 2e4);
}

TEST(Assembler, TheMaskLeavesOutAndCounts) {
  TurningSensor sensor;
  AssemblerConfig config;
  config.mask.sectors = {{350.0, 10.0}};
  PacketCounts counts;
  std::size_t points = 0;
  for (const DecodedSweep& sweep : assemble(packets_of(sensor, 300), config, &counts)) {
    std::uint32_t last_ns = 0;
    for (const Point& p : sweep.points) {
      const double deg = azimuth_deg(p);
      ASSERT_GT(deg, 9.99);
      ASSERT_LT(deg, 350.01);
      ASSERT_GE(p.time_ns, last_ns);
      last_ns = p.time_ns;
    }
    if (!sweep.points.empty()) {
      EXPECT_EQ(sweep.points.front().time_ns, 0U);
    }
    points += sweep.points.size();
  }
  EXPECT_EQ(points + counts.points_masked, 300U * 384U);
  EXPECT_EQ(counts.points, points);
  EXPECT_NEAR(static_cast<double>(counts.points_masked), 300.0 * 384.0 * 20.0 / 360.0, 700.0);
}

TEST(Assembler, FollowsTheMotorFrom5To20Hz) {
  TurningSensor sensor;
  sensor.rpm = 300.0;
  std::vector<Payload> packets = packets_of(sensor, 600);
  sensor.rpm = 1200.0;
  for (const Payload& packet : packets_of(sensor, 600)) packets.push_back(packet);
  const auto sweeps = assemble(packets);
  expect_in_time_order(sweeps);
  EXPECT_NEAR(sweeps[1].period_ns, 2e8, 1e5);
  EXPECT_NEAR(sweeps[sweeps.size() - 2].period_ns, 5e7, 1e5);
  EXPECT_NEAR(static_cast<double>(sweeps[sweeps.size() - 2].points.size()), 14467.0, 40.0);
}

TEST(Assembler, ARestrictedViewLosesNothingAndKeepsTime) {
  for (const double seam_deg : {0.0, 120.0}) {
    SCOPED_TRACE(seam_deg);
    TurningSensor sensor;
    sensor.view_first_deg = 90.0;
    sensor.view_last_deg = 180.0;
    sensor.azimuth_deg = 130.0;
    PacketCounts counts;
    const auto sweeps = assemble(packets_of(sensor, 400), {.seam_azimuth_deg = seam_deg}, &counts);
    ASSERT_GT(sweeps.size(), 15U);
    expect_in_time_order(sweeps);
    for (std::size_t i = 2; i + 1 < sweeps.size(); ++i) {
      SCOPED_TRACE(i);
      // From a quarter of a turn only.
      EXPECT_NEAR(sweeps[i].period_ns, 1e8, 3e5);
      EXPECT_NEAR(static_cast<double>(sweeps[i].stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 3e5);
      EXPECT_NEAR(static_cast<double>(sweeps[i].points.size()), 1808.4 * 16 / 4, 70.0);
    }
    EXPECT_LE(counts.lost, 60U) << "at most one gap before the view's edges are known";
  }
}

TEST(Assembler, AStoppedMotorEndsSweepsByTheGuard) {
  TurningSensor sensor;
  sensor.rpm = 0.0;
  const auto sweeps = assemble(packets_of(sensor, 760));
  ASSERT_EQ(sweeps.size(), 4U);
  expect_in_time_order(sweeps);
  for (const DecodedSweep& sweep : sweeps) {
    EXPECT_FALSE(sweep.complete);
    EXPECT_LE(sweep.points.back().time_ns, 300'200'000U);
  }
}

TEST(Assembler, AClockThatIsSetBeginsANewSweep) {
  TurningSensor sensor;
  std::vector<Payload> packets = packets_of(sensor, 150);
  sensor.time_us = 100'000.0;
  for (const Payload& packet : packets_of(sensor, 150)) packets.push_back(packet);
  PacketCounts counts;
  const auto sweeps = assemble(packets, {.clock_mode = ClockMode::kFreeRunning}, &counts);
  EXPECT_EQ(counts.clock_steps, 1U);
  EXPECT_EQ(counts.lost, 0U);
  EXPECT_EQ(counts.points, 300U * 384U);
  expect_in_time_order(sweeps);
}

TEST(Assembler, AStepForwardIsKnownByTheReceiveTimes) {
  TurningSensor sensor;
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (int i = 0; i < 200; ++i) {
    if (i == 100) sensor.time_us += 60e6;
    assembler.add(sensor.next(), received_ns);
    received_ns += 1'327'104;
  }
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 1U);
  EXPECT_EQ(assembler.counts().lost, 0U);
  const auto sweeps = sweeps_of(assembler);
  expect_in_time_order(sweeps);
  EXPECT_NEAR(static_cast<double>(sweeps.back().stamp_ns), 1.7e18 + 0.2e9, 0.1e9);
}

TEST(Assembler, TheTopOfTheHourIsNoStep) {
  TurningSensor sensor;
  sensor.time_us = 3'599'900'000.0;
  const auto packets = packets_of(sensor, 300);
  PacketCounts counts;
  // 1700002800 is a full hour; the host's clock is 10 s off either way.
  for (const std::int64_t off_s : {-10, 0, 10}) {
    SCOPED_TRACE(off_s);
    SweepAssembler assembler({}, {.clock_mode = ClockMode::kUtc});
    std::int64_t received_ns = (1'700'002'799 + off_s) * 1'000'000'000 + 901'327'104;
    for (const Payload& packet : packets) {
      assembler.add(packet, received_ns);
      received_ns += 1'327'104;
    }
    assembler.flush();
    EXPECT_EQ(assembler.counts().lost, 0U);
    EXPECT_EQ(assembler.counts().clock_steps, 0U);
    const auto sweeps = sweeps_of(assembler);
    expect_in_time_order(sweeps);
    EXPECT_EQ(sweeps.front().stamp_ns, 1'700'002'799'900'000'000);
    EXPECT_NEAR(static_cast<double>(sweeps.back().stamp_ns - sweeps.front().stamp_ns), 3e8, 2e5);
  }
}

TEST(Assembler, ReceiveClockTiesTheFirstPacketAndFollowsDriftSlowly) {
  TurningSensor sensor;
  SweepAssembler receive({}, {.clock_mode = ClockMode::kReceive});
  SweepAssembler free_running({}, {.clock_mode = ClockMode::kFreeRunning});
  const std::int64_t start_ns = 1'700'000'000'000'000'000;
  // The sensor's clock is 50 ppm slow against the host's; 60 s.
  for (std::int64_t packet = 0; packet < 45'000; ++packet) {
    const auto received_ns =
        start_ns + static_cast<std::int64_t>(1'327'104.0 * 1.00005 * static_cast<double>(packet));
    const Payload payload = sensor.next();
    receive.add(payload, received_ns);
    free_running.add(payload, 0);
  }
  std::vector<std::int64_t> followed_ns;
  DecodedSweep tied;
  DecodedSweep sensor_only;
  while (receive.take(tied) && free_running.take(sensor_only)) {
    followed_ns.push_back(tied.stamp_ns - sensor_only.stamp_ns);
    const std::int64_t step_ns =
        followed_ns.back() - followed_ns[followed_ns.size() > 1 ? followed_ns.size() - 2 : 0];
    ASSERT_LE(std::abs(step_ns), 10'100) << "no jump between sweeps";
  }
  ASSERT_GT(followed_ns.size(), 500U);
  const std::int64_t all_ns = followed_ns.back() - followed_ns.front();
  EXPECT_GT(all_ns, 1'500'000) << "3 ms of drift must mostly be followed";
  EXPECT_LT(all_ns, 3'100'000);
}

TEST(Assembler, DamagedPacketsNeverBreakTheSweeps) {
  std::mt19937 random(7);
  for (const std::uint8_t mode : {0x37, 0x39}) {
    TurningSensor sensor;
    sensor.mode = mode;
    SweepAssembler assembler({}, {});
    for (int i = 0; i < 4000; ++i) {
      Payload payload = sensor.next();
      // From a few wrong bytes to noise with a right tail.
      const int wrong = i % 5 == 0 ? 0 : i % 5 == 1 ? 1206 : 1 + static_cast<int>(random() % 20);
      for (int k = 0; k < wrong; ++k) {
        payload[random() % payload.size()] = static_cast<std::uint8_t>(random());
      }
      if (i % 2 == 0) payload[1204] = mode;
      if (i % 2 == 0) payload[1205] = 0x22;
      const std::size_t size = i % 11 == 0 ? random() % payload.size() : payload.size();
      assembler.add(std::span(payload).first(size), 0);
    }
    assembler.flush();
    const PacketCounts& counts = assembler.counts();
    EXPECT_EQ(counts.received, counts.decoded + counts.too_short + counts.foreign +
                                   counts.unknown_model + counts.model_mismatch +
                                   counts.unknown_mode + counts.bad_time + counts.duplicate +
                                   counts.late);
    EXPECT_GT(counts.decoded, 500U);
    for (const DecodedSweep& sweep : sweeps_of(assembler)) {
      ASSERT_EQ(sweep.points.size(), sweep.columns.size());
      std::uint32_t last_ns = 0;
      for (const Point& p : sweep.points) {
        ASSERT_TRUE(std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z));
        ASSERT_LT(p.ring, sweep.rings);
        ASSERT_GE(p.time_ns, last_ns);
        last_ns = p.time_ns;
      }
      ASSERT_LT(last_ns, 400'000'000U);
    }
  }
}

TEST(Clock, R1HourRollover) {
  const auto at = [](double reference_s, std::int64_t toh_us) {
    return resolve_hour_ns(toh_us, static_cast<std::int64_t>(reference_s * 1e3) * 1'000'000);
  };
  EXPECT_EQ(at(1700002799.95, 3599999900), 1700002799999900000);
  EXPECT_EQ(at(1700002800.02, 3599999900), 1700002799999900000);
  EXPECT_EQ(at(1700002799.98, 100), 1700002800000100000);
  EXPECT_EQ(at(1700002800.02, 100), 1700002800000100000);
  EXPECT_EQ(at(1700001000.00, 3600050000), 1699999200050000000);
  EXPECT_EQ(at(1700000000.00, 1234567890), 1700000434567890000);
}

TEST(Clock, DifferencesGoAcrossTheHour) {
  EXPECT_EQ(toh_difference_us(100, 3'599'999'900U), 200);
  EXPECT_EQ(toh_difference_us(3'599'999'900U, 100), -200);
  EXPECT_EQ(toh_difference_us(51'000, 3'600'050'000U), 1000);
}

}  // namespace
}  // namespace zloam::driver
