#pragma once
// Makes sweeps from handmade packets, for tests of the assembler.

#include <gtest/gtest.h>

#include <limits>
#include <random>
#include <vector>

#include "driver/sweep/assembler.hpp"
#include "driver/velodyne/decoder.hpp"
#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver::test {

using velodyne::test::Payload;
using velodyne::test::TurningSensor;

inline std::unique_ptr<PacketDecoder> decoder() {
  return std::make_unique<velodyne::Decoder>(velodyne::DecoderConfig{});
}

inline std::vector<Payload> packets_of(TurningSensor& sensor, int count) {
  std::vector<Payload> packets;
  for (int i = 0; i < count; ++i) packets.push_back(sensor.next());
  return packets;
}

inline std::vector<DecodedSweep> sweeps_of(SweepAssembler& assembler) {
  std::vector<DecodedSweep> sweeps;
  DecodedSweep sweep;
  while (assembler.take(sweep)) sweeps.push_back(sweep);
  return sweeps;
}

/// From complete packets, in this order.
template <class Packets>
std::vector<DecodedSweep> sweeps_of(SweepAssembler& assembler, const Packets& packets) {
  for (const auto& packet : packets) assembler.add(packet, 0);
  assembler.flush();
  return sweeps_of(assembler);
}

/// Changes some bytes of each packet, and truncates one in fifty.
inline void damage(std::vector<std::vector<std::uint8_t>>& packets, std::mt19937& random) {
  for (std::vector<std::uint8_t>& packet : packets) {
    for (unsigned i = random() % 20; i > 0; --i) {
      packet[random() % packet.size()] = static_cast<std::uint8_t>(random());
    }
    if (random() % 50 == 0) packet.resize(random() % packet.size());
  }
}

/// Properties of every sweep, for any input.
inline void expect_promises(const DecodedSweep& sweep) {
  ASSERT_EQ(sweep.points.size(), sweep.columns.size());
  std::uint32_t last_ns = 0;
  for (const Point& p : sweep.points) {
    ASSERT_TRUE(p.position().allFinite());
    ASSERT_LT(p.ring, sweep.rings);
    ASSERT_GE(p.time_ns, last_ns);
    last_ns = p.time_ns;
  }
  EXPECT_LT(last_ns, 400'000'000U);
}

inline std::vector<DecodedSweep> assemble(const std::vector<Payload>& packets,
                                          AssemblerConfig config = {},
                                          PacketCounts* counts = nullptr) {
  SweepAssembler assembler(decoder(), config);
  std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets);
  if (counts) *counts = assembler.counts();
  return sweeps;
}

inline void expect_in_time_order(const std::vector<DecodedSweep>& sweeps) {
  std::int64_t last_ns = std::numeric_limits<std::int64_t>::min();
  for (const DecodedSweep& sweep : sweeps) {
    ASSERT_EQ(sweep.points.size(), sweep.columns.size());
    for (const Point& p : sweep.points) {
      ASSERT_GE(sweep.stamp_ns + p.time_ns, last_ns);
      last_ns = sweep.stamp_ns + p.time_ns;
    }
  }
}

/// The same sweeps, point by point.
inline void expect_same(const std::vector<DecodedSweep>& got,
                        const std::vector<DecodedSweep>& expected) {
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

}  // namespace zloam::driver::test
