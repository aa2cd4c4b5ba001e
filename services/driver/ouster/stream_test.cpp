// Streams of packets, intact and damaged, cut into sweeps.
#include <gtest/gtest.h>

#include <random>

#include "driver/ouster/test_sensor.hpp"
#include "driver/sweep/test_sweeps.hpp"

namespace zloam::driver::ouster {
namespace {

using driver::test::damage;
using driver::test::expect_promises;
using driver::test::sweeps_of;
using test::Bytes;
using test::Description;

constexpr std::uint64_t kStartNs = 3'599'950'000'000;  // the hour ends after half a frame
constexpr int kPacketsPerFrame = 64;

/// Packets of this many frames; every pixel has a return. slower: the motor, against its nominal
/// speed.
std::vector<Bytes> packets_of(const Metadata& metadata, int frames, double slower = 1.0) {
  std::vector<Bytes> packets;
  for (int p = 0; p < frames * kPacketsPerFrame; ++p) {
    const auto after_ns =
        static_cast<std::uint64_t>(std::llround(16 * p * slower * metadata.column_ns()));
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

Metadata windowed() {
  Description description;
  description.window = "[200, 700]";
  return description.metadata();
}

TEST(OusterStream, AWindowLosesNothing) {
  const Metadata metadata = windowed();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 180.0});
  std::vector<Bytes> packets = packets_of(metadata, 5);
  packets.erase(packets.begin() + 40);  // in the second frame
  const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets);
  ASSERT_EQ(sweeps.size(), 5U);
  EXPECT_EQ(assembler.counts().lost, 1U);
  EXPECT_EQ(sweeps[1].packets_lost, 1U);
  EXPECT_TRUE(sweeps[2].complete && sweeps[3].complete);
}

// The time across the window's gap of 184 degrees is the motor's, not the nominal one.
TEST(OusterStream, ASlowMotorIsNoLossBehindTheWindow) {
  const Metadata metadata = windowed();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 180.0});
  const std::vector<DecodedSweep> sweeps = sweeps_of(assembler, packets_of(metadata, 5, 1.02));
  ASSERT_EQ(sweeps.size(), 5U);
  EXPECT_LE(assembler.counts().lost, 1U) << "at most one, before the gap is known";
  EXPECT_TRUE(sweeps[2].complete && sweeps[3].complete);
}

TEST(OusterStream, ALossAtTheWindowsEdgeIsCounted) {
  const Metadata metadata = windowed();
  SweepAssembler assembler(decoder_of(metadata), {.seam_azimuth_deg = 180.0});
  std::vector<Bytes> packets = packets_of(metadata, 5);
  packets.erase(packets.begin() + 3 * 32);  // the fourth frame's first
  sweeps_of(assembler, packets);
  EXPECT_EQ(assembler.counts().lost, 1U);
}

TEST(OusterStream, DamagedPacketsBreakNoPromise) {
  std::mt19937 random(11);
  for (const char* profile : {"LEGACY", "RNG19_RFL8_SIG16_NIR16_DUAL"}) {
    Description description;
    description.profile = profile;
    const Metadata metadata = description.metadata();
    SweepAssembler assembler(decoder_of(metadata), {});
    std::vector<Bytes> packets = packets_of(metadata, 12);
    damage(packets, random);
    for (const DecodedSweep& sweep : sweeps_of(assembler, packets)) expect_promises(sweep);
  }
}

}  // namespace
}  // namespace zloam::driver::ouster
