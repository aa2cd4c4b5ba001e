// A stream of packets through the cut into sweeps, whole and damaged.
#include <gtest/gtest.h>

#include <random>

#include "driver/ouster/test_sensor.hpp"
#include "driver/sweep/assembler.hpp"

namespace zloam::driver::ouster {
namespace {

using test::Bytes;
using test::Description;

constexpr std::uint64_t kStartNs = 3'599'950'000'000;  // the hour ends after half a frame
constexpr int kPacketsPerFrame = 64;

/// The packets of frames in which every pixel has a return.
std::vector<Bytes> packets_of(const Metadata& metadata, int frames) {
  std::vector<Bytes> packets;
  for (int p = 0; p < frames * kPacketsPerFrame; ++p) {
    const auto after_ns = static_cast<std::uint64_t>(std::llround(16 * p * metadata.column_ns()));
    const int first_column = 16 * (p % kPacketsPerFrame);
    if (!metadata.sees(first_column) && !metadata.sees(first_column + 15)) continue;
    packets.push_back(test::empty_packet(metadata, first_column, kStartNs + after_ns));
    for (int c = 0; c < 16; ++c) {
      for (int pixel = 0; pixel < metadata.pixels_per_column; ++pixel) {
        test::put<std::uint16_t>(packets.back(), test::pixel_at(metadata, c, pixel), 4000);
      }
    }
  }
  return packets;
}

std::vector<DecodedSweep> sweeps_of(SweepAssembler& assembler, const std::vector<Bytes>& packets) {
  for (const Bytes& packet : packets) assembler.add(packet, 0);
  assembler.flush();
  std::vector<DecodedSweep> sweeps;
  DecodedSweep sweep;
  while (assembler.take(sweep)) sweeps.push_back(sweep);
  return sweeps;
}

std::unique_ptr<PacketDecoder> decoder_of(const Metadata& metadata) {
  return std::make_unique<Decoder>(metadata, DecodingOptions{});
}

TEST(OusterStream, FramesAreCutAtTheSeam) {
  const Metadata metadata = Description{}.metadata();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 180.0});
  const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets_of(metadata, 4));
  ASSERT_EQ(sweeps.size(), 4U);
  for (std::size_t i = 0; i < sweeps.size(); ++i) {
    SCOPED_TRACE(i);
    EXPECT_EQ(sweeps[i].complete, i == 1 || i == 2);
    EXPECT_EQ(sweeps[i].points.size(), 16384U);
    EXPECT_EQ(sweeps[i].rings, 16);
    EXPECT_EQ(sweeps[i].model, "OS-1-16");
    EXPECT_NEAR(sweeps[i].period_ns, 1e8, 1e4);
    EXPECT_EQ(sweeps[i].columns.front(), 0);
    EXPECT_EQ(sweeps[i].columns.back(), 1023);
    if (i == 0) continue;
    EXPECT_NEAR(static_cast<double>(sweeps[i].stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 2.0);
  }
  EXPECT_EQ(assembler.counts().lost, 0U);
}

TEST(OusterStream, ColumnsAreByTheAngleWhateverTheSeam) {
  const Metadata metadata = Description{}.metadata();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 33.3});
  const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets_of(metadata, 3));
  ASSERT_EQ(sweeps.size(), 4U);
  ASSERT_TRUE(sweeps[1].complete);
  for (std::size_t i = 0; i < sweeps[1].columns.size(); ++i) {
    ASSERT_EQ(sweeps[1].columns[i], i / 16);
  }
}

TEST(OusterStream, AWindowLosesNothing) {
  Description description;
  description.window = "[200, 700]";
  const Metadata metadata = description.metadata();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 180.0});
  std::vector<Bytes> packets = packets_of(metadata, 5);
  packets.erase(packets.begin() + 40);  // in the second frame
  const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets);
  ASSERT_EQ(sweeps.size(), 5U);
  EXPECT_EQ(assembler.counts().lost, 1U);
  EXPECT_EQ(sweeps[1].packets_lost, 1U);
  EXPECT_TRUE(sweeps[2].complete && sweeps[3].complete);
}

TEST(OusterStream, DamagedPacketsBreakNoPromise) {
  std::mt19937 random(11);
  for (const char* profile : {"LEGACY", "RNG19_RFL8_SIG16_NIR16_DUAL"}) {
    Description description;
    description.profile = profile;
    const Metadata metadata = description.metadata();
    SweepAssembler assembler(decoder_of(metadata), {});
    std::vector<Bytes> packets = packets_of(metadata, 12);
    for (Bytes& packet : packets) {
      for (unsigned i = random() % 20; i > 0; --i) {
        packet[random() % packet.size()] = static_cast<std::uint8_t>(random());
      }
      if (random() % 50 == 0) packet.resize(random() % packet.size());
    }
    for (const DecodedSweep& sweep : sweeps_of(assembler, packets)) {
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
  }
}

}  // namespace
}  // namespace zloam::driver::ouster
