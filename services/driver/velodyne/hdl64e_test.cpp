// Packets of an HDL-64E made byte by byte. Expected positions and intensities are from the
// published vector S1 and the manual's formulas, firing times from the tables of two public
// decoders.
#include "driver/velodyne/hdl64e.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "driver/decoder/makers.hpp"
#include "driver/decoder/test_decoding.hpp"
#include "driver/sweep/assembler.hpp"
#include "driver/velodyne/test_calibration.hpp"
#include "driver/velodyne/test_packets.hpp"
#include "driver/velodyne/velodyne.hpp"

namespace zloam::driver::velodyne {
namespace {

using driver::test::decode_all;
using test::Payload;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// Upper and lower blocks alternate; two blocks share an azimuth, or four with two returns.
Payload payload_of(int first_cdeg, int step_cdeg, bool dual,
                   const std::vector<test::CellBytes>& cells,
                   const std::array<std::uint8_t, 6>& tail) {
  std::vector<int> azimuths;
  for (int k = 0; k < kBlocksPerPacket; ++k) {
    azimuths.push_back((first_cdeg + step_cdeg * (k / (dual ? 4 : 2))) % kTurnCdeg);
  }
  Payload payload = test::make_payload(azimuths, cells, tail);
  for (std::size_t k = 1; k < kBlocksPerPacket; k += 2) payload[100 * k + 1] = 0xDD;
  return payload;
}

std::array<std::uint8_t, 6> tail_of(std::uint32_t toh_us) {
  return {static_cast<std::uint8_t>(toh_us),
          static_cast<std::uint8_t>(toh_us >> 8),
          static_cast<std::uint8_t>(toh_us >> 16),
          static_cast<std::uint8_t>(toh_us >> 24),
          0x48,
          0x0C};
}

DecodingOptions options_of(const char* model) {
  DecodingOptions options;
  options.model = model;
  options.metadata = test::calibration_yaml();
  options.metadata_name = "unit.yaml";
  return options;
}

std::unique_ptr<PacketDecoder> decoder_for(const Payload& first, const DecodingOptions& options) {
  std::vector<std::string> remarks;
  return make(options)->decoder({{first.begin(), first.end()}}, remarks);
}

struct Vector {
  std::array<std::uint8_t, 3> bytes;
  std::uint32_t crc;
  double x_m, y_m, z_m, intensity;
};

TEST(Hdl64e, TheTwoPointCorrectionOfThePublishedVector) {
  const Vector vectors[] = {
      {{0xA0, 0x0F, 0x0A}, 0x7245A53E, 6.095286, -7.075611, -0.968185, 26.829},
      {{0xF8, 0x2A, 0x00}, 0xEF9884CD, 15.139036, -17.616011, -2.730448, 72.766},
      {{0x20, 0x4E, 0x28}, 0x0F8CBD67, 26.766326, -31.169158, -4.996138, 212.080},
  };
  for (const Vector& vector : vectors) {
    const Payload payload = payload_of(4500, 18, false, {{0, 0, vector.bytes}}, tail_of(1000));
    ASSERT_EQ(test::crc32(payload), vector.crc);
    const std::vector<Point> points =
        decode_all(*decoder_for(payload, options_of("HDL-64E S3")), payload);
    ASSERT_EQ(points.size(), 1U);
    EXPECT_NEAR(points[0].x, vector.x_m, 1e-5);
    EXPECT_NEAR(points[0].y, vector.y_m, 1e-5);
    EXPECT_NEAR(points[0].z, vector.z_m, 1e-5);
    EXPECT_NEAR(points[0].intensity, vector.intensity, 1e-3);
    EXPECT_EQ(points[0].ring, 63);  // the highest laser of the test's calibration
  }
}

struct Firing {
  const char* model;
  bool dual;
  int block, channel;
  double before_stamp_us;  // by the tables of VeloView
};

TEST(Hdl64e, FiringTimesCountBackFromTheStamp) {
  const Firing firings[] = {
      {"HDL-64E S2", false, 0, 0, 48.0 * 5 + 6.0 * 7 + 6.0},
      {"HDL-64E S2", false, 5, 13, 48.0 * 3 + 6.0 * 4 + 4.74},
      {"HDL-64E S2", false, 11, 31, 2.34},
      {"HDL-64E S3", true, 0, 0, 57.6 * 2 + 7.2 * 7 + 7.2},
      {"HDL-64E S3", true, 7, 10, 57.6 * 1 + 7.2 * 5 + 4.7},
      {"HDL-64E S3", true, 11, 31, 3.5},
  };
  constexpr std::uint32_t kStampUs = 3'599'999'000;
  for (const Firing& firing : firings) {
    SCOPED_TRACE(firing.model + std::string(" ") + std::to_string(firing.block));
    const Payload payload = payload_of(
        100, 18, firing.dual, {{firing.block, firing.channel, {0x88, 0x13, 9}}}, tail_of(kStampUs));
    const auto decoder = decoder_for(payload, options_of(firing.model));
    const std::vector<Point> points = decode_all(*decoder, payload);
    ASSERT_EQ(points.size(), 1U);
    const double at_us = decoder->tail(payload).toh_us + 1e-3 * points[0].time_ns;
    EXPECT_NEAR(kStampUs - at_us, firing.before_stamp_us, 0.002);
  }
}

TEST(Hdl64e, BlocksTellWhichLasersTheyAreOf) {
  const Payload payload = payload_of(
      0, 18, false, {{0, 3, {0x88, 0x13, 9}}, {1, 3, {0x88, 0x13, 9}}}, tail_of(1'000'000));
  const std::vector<Point> points =
      decode_all(*decoder_for(payload, options_of("HDL-64E S2")), payload);
  ASSERT_EQ(points.size(), 2U);
  EXPECT_EQ(points[0].ring, 60);
  EXPECT_EQ(points[1].ring, 28);
  EXPECT_EQ(points[0].time_ns, points[1].time_ns);
}

TEST(Hdl64e, TwoReturnsByEqualAzimuths) {
  const Payload payload = payload_of(0, 18, true,
                                     {{0, 4, {0x88, 0x13, 50}},   // strongest, 10 m
                                      {2, 4, {0x10, 0x27, 60}},   // last, 20 m
                                      {1, 4, {0x88, 0x13, 70}},   // a lower laser,
                                      {3, 4, {0x88, 0x13, 70}}},  // both returns equal
                                     tail_of(1'000'000));
  const auto decoder = decoder_for(payload, options_of("HDL-64E S3"));
  EXPECT_EQ(decoder->tail(payload).mode, ReturnMode::kDual);
  const std::vector<Point> points = decode_all(*decoder, payload);
  std::vector<ReturnType> types;
  for (const Point& point : points) types.push_back(point.return_type);
  EXPECT_THAT(types, ElementsAre(ReturnType::kLast, ReturnType::kStrongest, ReturnType::kBoth));
  EXPECT_GT(points[0].position().norm(), points[1].position().norm());
}

TEST(Hdl64e, AStandingMotorChangesNoMode) {
  const Payload turning = payload_of(0, 18, false, {}, tail_of(1'000'000));
  const Payload standing = payload_of(700, 0, false, {}, tail_of(1'000'288));
  const auto decoder = decoder_for(turning, options_of("HDL-64E S2"));
  EXPECT_EQ(decoder->tail(turning).mode, ReturnMode::kStrongest);
  EXPECT_EQ(decoder->tail(standing).mode, ReturnMode::kStrongest);
}

TEST(Hdl64e, WithoutModelOrCalibrationItIsSaid) {
  const Payload payload = payload_of(0, 18, false, {}, tail_of(1'000'000));
  const auto said = [&](const DecodingOptions& options) {
    const auto decoder = decoder_for(payload, options);
    EXPECT_EQ(decoder->tail(payload).reject, Reject::kUnknownModel);
    return decoder->contradictions().front();
  };
  EXPECT_THAT(said({}), HasSubstr("driver.model"));
  EXPECT_THAT(said({}), HasSubstr("driver.metadata"));
  DecodingOptions damaged = options_of("HDL-64E S2");
  damaged.metadata = test::calibration_yaml(60);
  EXPECT_THAT(said(damaged), HasSubstr("unit.yaml, as an HDL-64E's calibration: laser 60 is"));
  EXPECT_THAT(Makers(damaged).metadata_error(), HasSubstr("laser 60 is missing"));
  EXPECT_THAT(Makers(options_of("HDL-64E S2")).metadata_error(), IsEmpty());
  damaged.metadata = "no description at all";
  EXPECT_THAT(Makers(damaged).metadata_error(),
              HasSubstr("none of what can be read: an HDL-64E's calibration (XML or YAML), an "
                        "Ouster sensor's metadata (JSON), a Hesai sensor's angle corrections"));
}

TEST(Hdl64e, PacketsOfAnotherModelAreNamed) {
  const auto decoder =
      decoder_for(payload_of(0, 18, false, {}, tail_of(1'000'000)), options_of("HDL-64E S2"));
  test::TurningSensor vlp16;
  EXPECT_EQ(decoder->tail(vlp16.next()).reject, Reject::kModelMismatch);
  EXPECT_EQ(decoder->tail(vlp16.next()).reject, Reject::kModelMismatch);
  ASSERT_EQ(decoder->contradictions().size(), 1U);
  EXPECT_THAT(decoder->contradictions()[0], HasSubstr("VLP-16"));
  Payload vls128 = payload_of(0, 18, false, {}, tail_of(1'000'000));
  vls128[201] = 0xCC;
  vls128[301] = 0xBB;
  EXPECT_EQ(decoder->tail(vls128).reject, Reject::kModelMismatch);
  // A damaged flag does not make another sensor, whatever it became.
  for (const std::uint8_t flag : {0x00, 0xCC, 0xBB}) {
    Payload damaged = payload_of(0, 18, false, {}, tail_of(1'000'000));
    damaged[101] = flag;
    const PacketTail tail = decoder->tail(damaged);
    EXPECT_EQ(tail.reject, Reject::kNone);
    EXPECT_EQ(decoder->plan(damaged, tail.mode).bad_blocks, 1);
  }
}

TEST(Hdl64e, TurnsBecomeSweeps) {
  // 10 revolutions per second: 0.1728 degrees from group to group.
  constexpr int kPackets = 348 * 3;
  std::unique_ptr<SweepAssembler> assembler;
  std::vector<DecodedSweep> sweeps;
  DecodedSweep sweep;
  for (int p = 0; p < kPackets; ++p) {
    const double first_cdeg = std::fmod(6 * 17.28 * p, 36000.0);
    Payload payload = payload_of(0, 0, false, {}, tail_of(1'000'000 + 288U * p));
    for (int k = 0; k < kBlocksPerPacket; ++k) {
      const auto at = 100 * static_cast<std::size_t>(k);
      const auto cdeg = static_cast<unsigned>(std::lround(first_cdeg + 17.28 * (k / 2))) % 36000U;
      payload[at + 2] = static_cast<std::uint8_t>(cdeg);
      payload[at + 3] = static_cast<std::uint8_t>(cdeg >> 8);
      for (std::size_t c = 0; c < 32; ++c) payload[at + 4 + 3 * c + 1] = 0x13;
    }
    if (!assembler) {
      assembler = std::make_unique<SweepAssembler>(decoder_for(payload, options_of("HDL-64E S2")),
                                                   AssemblerConfig{});
    }
    assembler->add(payload, 0);
    while (assembler->take(sweep)) sweeps.push_back(sweep);
  }
  ASSERT_GE(sweeps.size(), 3U);
  EXPECT_TRUE(sweeps[1].complete);
  EXPECT_NEAR(sweeps[1].period_ns, 1e8, 1e5);
  EXPECT_NEAR(static_cast<double>(sweeps[1].points.size()), 64 * 36000 / 17.28, 200.0);
  EXPECT_EQ(sweeps[1].rings, 64);
  EXPECT_EQ(assembler->counts().lost, 0U);
  std::uint32_t last_ns = 0;
  for (const Point& point : sweeps[1].points) {
    ASSERT_GE(point.time_ns, last_ns);
    last_ns = point.time_ns;
  }
}

}  // namespace
}  // namespace zloam::driver::velodyne
