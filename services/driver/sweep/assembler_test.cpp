#include "driver/sweep/assembler.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "driver/sweep/test_sweeps.hpp"

namespace zloam::driver {
namespace {

using test::assemble;
using test::expect_in_time_order;
using test::packets_of;
using test::Payload;
using test::sweeps_of;
using test::TurningSensor;

double azimuth_deg(const Point& p) {
  const double deg = std::atan2(-p.y, p.x) * 180.0 / M_PI;
  return deg < 0.0 ? deg + 360.0 : deg;
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
    // 1808.4 firings of 16 lasers in a revolution; sweeps are cut at groups of two firings.
    EXPECT_NEAR(static_cast<double>(sweep.points.size()), 1808.4 * 16, 33.0);
    EXPECT_EQ(sweep.columns.front(), 0);
    EXPECT_NEAR(sweep.columns.back(), 1807, 2);
    if (i > 1) {
      EXPECT_NEAR(static_cast<double>(sweep.stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 1.2e5);
    }
  }
}

TEST(Assembler, AMotorThatHardlyTurnsHasTheLongestPeriod) {
  // 14.4 degrees in the 300 ms after which a sweep ends: 7.5 s for a revolution.
  TurningSensor sensor;
  sensor.rpm = 8.0;
  const auto sweeps = assemble(packets_of(sensor, 900));
  ASSERT_GE(sweeps.size(), 3U);
  for (std::size_t i = 0; i + 1 < sweeps.size(); ++i) {
    EXPECT_EQ(sweeps[i].period_ns, std::numeric_limits<std::uint32_t>::max()) << i;
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

TEST(Assembler, SaysWhichPacketsASweepIsOf) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 300);
  const auto stamp_us = [&](std::size_t packet) {
    std::uint32_t toh_us = 0;
    std::memcpy(&toh_us, packets[packet].data() + 1200, sizeof(toh_us));
    return toh_us;
  };
  std::size_t last = 0;
  for (const DecodedSweep& sweep : assemble(packets)) {
    SCOPED_TRACE(last);
    // The packet in which a revolution ends belongs to both sweeps.
    const bool shared = sweep.first_packet_toh_us == stamp_us(last);
    const std::size_t first = shared ? last : last + 1;
    ASSERT_LT(first + sweep.packets - 1, packets.size());
    EXPECT_EQ(sweep.first_packet_toh_us, stamp_us(first));
    last = first + sweep.packets - 1;
    EXPECT_EQ(sweep.last_packet_toh_us, stamp_us(last));
    // Manual 63-9243, section 9.5: 24 firings of 55.296 us.
    EXPECT_EQ(sweep.packet_period_ns, 1'327'104U);
  }
  EXPECT_EQ(last, packets.size() - 1);
}

TEST(Assembler, ColumnsAreTheFirings) {
  TurningSensor sensor;
  std::size_t points = 0;
  for (const DecodedSweep& sweep : assemble(packets_of(sensor, 200))) {
    for (std::size_t i = 0; i < sweep.points.size(); ++i) {
      ASSERT_EQ(sweep.columns[i], i / 16);
    }
    points += sweep.points.size();
  }
  EXPECT_EQ(points, 200U * 384U);
}

TEST(Assembler, AcceptsAllLengthsButDecodesOnlyItsOwn) {
  TurningSensor sensor;
  SweepAssembler assembler(test::decoder(), {});
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
      // The view is restricted to a quarter of a revolution.
      EXPECT_NEAR(sweeps[i].period_ns, 1e8, 3e5);
      EXPECT_NEAR(static_cast<double>(sweeps[i].stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 3e5);
      EXPECT_NEAR(static_cast<double>(sweeps[i].points.size()), 1808.4 * 16 / 4, 70.0);
    }
    EXPECT_LE(counts.lost, 60U) << "at most one gap before the view's edges are known";
  }
}

TEST(Assembler, ALossBesideTheGapOfARestrictedViewIsCounted) {
  TurningSensor sensor;
  sensor.view_first_deg = 90.0;
  sensor.view_last_deg = 180.0;
  sensor.azimuth_deg = 130.0;
  const std::vector<Payload> packets = packets_of(sensor, 300);
  // A packet that contains the gap, after some turns: its azimuths go back to the view's begin.
  const auto azimuth = [&](std::size_t packet, std::size_t block) {
    return packets[packet][100 * block + 2] + 256 * packets[packet][100 * block + 3];
  };
  std::size_t gap = 200;
  while (azimuth(gap, 11) > azimuth(gap, 0)) ++gap;
  std::vector<Payload> kept = packets;
  kept.erase(kept.begin() + static_cast<std::ptrdiff_t>(gap) + 1);
  PacketCounts whole;
  PacketCounts lossy;
  assemble(packets, {}, &whole);
  assemble(kept, {}, &lossy);
  EXPECT_EQ(lossy.lost, whole.lost + 1);
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

TEST(Assembler, DamagedPacketsNeverBreakTheSweeps) {
  std::mt19937 random(7);
  for (const std::uint8_t mode : {0x37, 0x39}) {
    TurningSensor sensor;
    sensor.mode = mode;
    SweepAssembler assembler(test::decoder(), {});
    for (int i = 0; i < 4000; ++i) {
      Payload payload = sensor.next();
      // From a few wrong bytes up to random bytes with only the packet's tail correct.
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

}  // namespace
}  // namespace zloam::driver
