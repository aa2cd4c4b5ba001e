// Streams of packets, intact and damaged, cut into sweeps.
#include <gtest/gtest.h>

#include <random>

#include "driver/hesai/hesai.hpp"
#include "driver/hesai/test_packets.hpp"
#include "driver/sweep/test_sweeps.hpp"

namespace zloam::driver::hesai {
namespace {

using driver::test::damage;
using driver::test::expect_promises;
using driver::test::sweeps_of;
using test::Bytes;

constexpr int kPacketsPerTurn = 250;  // 400 us each

/// Packets of revolutions in which each laser has returns, at 8 m (and 10 m with two returns); the
/// hour ends within the first revolution.
std::vector<Bytes> packets_of(int turns, std::uint8_t mode) {
  const int returns = mode >= 0x39 ? 2 : 1;
  std::vector<Bytes> packets;
  for (int p = 0; p < turns * kPacketsPerTurn * returns; ++p) {
    const auto time_us = static_cast<std::uint32_t>(3'599'960'000U + 400U / returns * p);
    const double azimuth_deg = std::fmod(1.44 / returns * p, 360.0);
    packets.push_back(test::packet(32, mode, time_us % 3'600'000'000U, azimuth_deg, 0.18));
    for (int block = 0; block < 8; ++block) {
      for (int laser = 0; laser < 32; ++laser) {
        test::set_cell(packets.back(), 32, block, laser, 2000U + 500U * (block % returns), 5);
      }
    }
  }
  return packets;
}

std::unique_ptr<PacketDecoder> decoder_of(const std::vector<Bytes>& packets) {
  std::vector<std::string> remarks;
  return make({})->decoder({packets.front()}, remarks);
}

TEST(HesaiStream, TurnsBecomeSweeps) {
  for (const std::uint8_t mode : {0x37, 0x39}) {
    SCOPED_TRACE(int{mode});
    const std::vector<Bytes> packets = packets_of(4, mode);
    SweepAssembler assembler(decoder_of(packets), {});
    const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets);
    ASSERT_EQ(sweeps.size(), 4U);
    for (std::size_t i = 1; i < 3; ++i) {
      EXPECT_TRUE(sweeps[i].complete);
      EXPECT_EQ(sweeps[i].points.size(), (mode == 0x39 ? 2U : 1U) * 64'000U);
      EXPECT_EQ(sweeps[i].rings, 32);
      EXPECT_EQ(sweeps[i].model, "PandarXT-32");
      EXPECT_NEAR(sweeps[i].period_ns, 1e8, 1e5);
      expect_promises(sweeps[i]);
    }
    EXPECT_NEAR(static_cast<double>(sweeps[2].stamp_ns - sweeps[1].stamp_ns), 1e8, 5e4);
    EXPECT_EQ(assembler.counts().lost, 0U);
  }
}

TEST(HesaiStream, LossIsCounted) {
  std::vector<Bytes> packets = packets_of(4, 0x37);
  packets.erase(packets.begin() + 300, packets.begin() + 303);
  SweepAssembler assembler(decoder_of(packets), {});
  sweeps_of(assembler, packets);
  EXPECT_EQ(assembler.counts().lost, 3U);
}

TEST(HesaiStream, DamagedPacketsBreakNoPromise) {
  std::mt19937 random(12);
  for (const std::uint8_t mode : {0x37, 0x39, 0x3C}) {
    std::vector<Bytes> packets = packets_of(4, mode);
    SweepAssembler assembler(decoder_of(packets), {});
    damage(packets, random);
    for (const DecodedSweep& sweep : sweeps_of(assembler, packets)) expect_promises(sweep);
  }
}

}  // namespace
}  // namespace zloam::driver::hesai
