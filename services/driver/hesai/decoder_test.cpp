// Packets made from the manual's tables, decoded to points and compared with the manual's formulas.
#include "driver/hesai/decoder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "driver/decoder/makers.hpp"
#include "driver/decoder/test_decoding.hpp"
#include "driver/hesai/hesai.hpp"
#include "driver/hesai/test_packets.hpp"

namespace zloam::driver::hesai {
namespace {

using driver::test::decode_all;
using test::Bytes;
using test::packet;
using test::set_cell;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr std::uint32_t kTimeUs = 754'321'000;
constexpr double kStepDeg = 0.18;  // 600 revolutions per minute

/// By the manual, "Point Cloud Data Analysis": the horizontal angle is the sum of the block's
/// azimuth, the laser's offset, and the rotation until it fires; angle 0 is y in the manual, x
/// here.
Eigen::Vector3d by_the_manual(double block_azimuth_deg, double firing_us, double elevation_deg,
                              double offset_deg, double range_m) {
  constexpr double kRad = std::numbers::pi / 180.0;
  const double turn_deg_per_us = kStepDeg / 50.0;
  const double azimuth = kRad * (block_azimuth_deg + offset_deg + turn_deg_per_us * firing_us);
  const double elevation = kRad * elevation_deg;
  const double manual_x = range_m * std::cos(elevation) * std::sin(azimuth);
  const double manual_y = range_m * std::cos(elevation) * std::cos(azimuth);
  return {manual_y, -manual_x, range_m * std::sin(elevation)};
}

std::unique_ptr<PacketDecoder> decoder_for(const Bytes& first,
                                           const DecodingOptions& options = {}) {
  std::vector<std::string> remarks;
  return make(options)->decoder({first}, remarks);
}

void expect_at(const Point& point, const Eigen::Vector3d& expected_m) {
  EXPECT_LT((point.position().cast<double>() - expected_m).norm(), 2e-6 + 3e-7 * expected_m.norm());
}

TEST(HesaiDecoder, Xt32OneReturn) {
  Bytes bytes = packet(32, 0x37, kTimeUs, 100.0, kStepDeg);
  ASSERT_EQ(bytes.size(), 1080U);  // manual
  set_cell(bytes, 32, 0, 0, 2500, 77);
  set_cell(bytes, 32, 3, 15, 30000, 255);
  set_cell(bytes, 32, 7, 31, 1, 0);
  const auto decoder = decoder_for(bytes);
  const std::vector<Point> points = decode_all(*decoder, bytes);
  ASSERT_EQ(points.size(), 3U);
  expect_at(points[0], by_the_manual(100.0, 0.0, 15.0, 0.0, 10.0));
  expect_at(points[1], by_the_manual(100.54, 15 * 1.512, 0.0, 0.0, 120.0));
  expect_at(points[2], by_the_manual(101.26, 31 * 1.512, -16.0, 0.0, 0.004));
  EXPECT_EQ(points[0].ring, 31);
  EXPECT_EQ(points[1].ring, 16);
  EXPECT_EQ(points[2].ring, 0);
  EXPECT_EQ(points[0].intensity, 77.0F);
  EXPECT_EQ(points[1].intensity, 255.0F);
  EXPECT_EQ(points[0].return_type, ReturnType::kStrongest);
  EXPECT_EQ(decoder->shape().model, "PandarXT-32");
  EXPECT_EQ(decoder->shape().rings, 32);
}

TEST(HesaiDecoder, TimesCountBackFromTheLastBlock) {
  Bytes bytes = packet(32, 0x38, kTimeUs, 0.0, kStepDeg);
  for (int block = 0; block < 8; ++block) set_cell(bytes, 32, block, 10, 1000, 1);
  const auto decoder = decoder_for(bytes);
  const std::vector<Point> points = decode_all(*decoder, bytes);
  ASSERT_EQ(points.size(), 8U);
  for (int block = 0; block < 8; ++block) {
    const double since_stamp_us = 1e-3 * points[static_cast<std::size_t>(block)].time_ns +
                                  static_cast<double>(decoder->tail(bytes).toh_us) - kTimeUs;
    EXPECT_NEAR(since_stamp_us, 5.632 - 50.0 * (7 - block) + 0.368 + 1.512 * 10, 1e-3);
    EXPECT_EQ(points[static_cast<std::size_t>(block)].return_type, ReturnType::kLast);
  }
}

TEST(HesaiDecoder, TheHourBeginsWithinAPacket) {
  const Bytes bytes = packet(32, 0x37, 100, 0.0, kStepDeg);
  EXPECT_EQ(decoder_for(bytes)->tail(bytes).toh_us, 3'599'999'750U);
}

TEST(HesaiDecoder, Xt16UsesEverySecondLaser) {
  Bytes bytes = packet(16, 0x37, kTimeUs, 359.9, kStepDeg);
  ASSERT_EQ(bytes.size(), 568U);
  set_cell(bytes, 16, 0, 4, 1000, 9);   // channel 5: 7 degrees (manual, appendix I)
  set_cell(bytes, 16, 1, 15, 1000, 9);  // channel 16: -15 degrees
  const auto decoder = decoder_for(bytes);
  const std::vector<Point> points = decode_all(*decoder, bytes);
  ASSERT_EQ(points.size(), 2U);
  expect_at(points[0], by_the_manual(359.9, 8 * 1.512, 7.0, 0.0, 4.0));
  expect_at(points[1], by_the_manual(360.08, 30 * 1.512, -15.0, 0.0, 4.0));
  EXPECT_EQ(points[0].ring, 11);
  EXPECT_EQ(points[1].ring, 0);
}

TEST(HesaiDecoder, TheUnitsOwnAngles) {
  std::string text = "Laser id,Elevation,Azimuth\r\n";
  for (int i = 0; i < 32; ++i) {
    text += std::to_string(i + 1) + "," + std::to_string(15.03 - i) + ", " +
            std::to_string(0.01 * (i % 5)) + "\r\n";
  }
  Bytes bytes = packet(32, 0x37, kTimeUs, 20.0, kStepDeg);
  set_cell(bytes, 32, 2, 8, 5000, 3);
  DecodingOptions options;
  options.metadata = text;
  options.metadata_name = "unit.csv";
  const std::vector<Point> points = decode_all(*decoder_for(bytes, options), bytes);
  ASSERT_EQ(points.size(), 1U);
  expect_at(points[0], by_the_manual(20.36, 8 * 1.512, 7.03, 0.03, 20.0));
}

TEST(HesaiDecoder, AnglesOfAnotherSensorAreRefused) {
  std::string text = "Channel,Elevation,Azimuth\n";
  for (int i = 0; i < 16; ++i) text += std::to_string(i + 1) + ",1,0\n";
  DecodingOptions options;
  options.metadata = text;
  options.metadata_name = "unit.csv";
  const Bytes bytes = packet(32, 0x37, kTimeUs, 20.0, kStepDeg);
  const auto decoder = decoder_for(bytes, options);
  EXPECT_EQ(decoder->tail(bytes).reject, Reject::kUnknownModel);
  EXPECT_THAT(decoder->contradictions().front(), HasSubstr("unit.csv has the angles of 16 lasers"));
}

TEST(HesaiDecoder, FilesThatHoldNoAngles) {
  const auto error_of = [](std::string_view text) {
    const auto parsed = parse_angle_corrections(text);
    const auto* error = std::get_if<std::string>(&parsed);
    return error ? *error : std::string();
  };
  EXPECT_THAT(error_of(""), HasSubstr("0 lasers"));
  EXPECT_THAT(error_of("{\n \"sensor_info\": 1\n}"), HasSubstr("line 2"));
  EXPECT_THAT(error_of("Laser id,Elevation,Azimuth\n2,1,0\n"), HasSubstr("line 2: laser 1"));
  EXPECT_THAT(error_of("1,90,0\n"), HasSubstr("line 1: no such angles"));
  EXPECT_THAT(error_of("1,nan,0\n"), HasSubstr("line 1: no such angles"));
  EXPECT_THAT(error_of("1,2\n1,2,3"), HasSubstr("1 lasers"));  // a header, then laser 1
}

/// Two returns of one laser, with raw distances in the odd and the even block.
std::vector<Point> pair_of(std::uint8_t mode, unsigned odd, unsigned even,
                           DualReturns policy = DualReturns::kTagged) {
  Bytes bytes = packet(32, mode, kTimeUs, 10.0, kStepDeg);
  set_cell(bytes, 32, 4, 6, odd, 10);
  set_cell(bytes, 32, 5, 6, even, 20);
  DecodingOptions options;
  options.dual_returns = policy;
  return decode_all(*decoder_for(bytes, options), bytes);
}

TEST(HesaiDecoder, PairsOfReturns) {
  const std::vector<Point> both = pair_of(0x39, 2000, 1000);
  ASSERT_EQ(both.size(), 2U);
  expect_at(both[0], by_the_manual(10.36, 6 * 1.512, 9.0, 0.0, 8.0));
  expect_at(both[1], by_the_manual(10.36, 6 * 1.512, 9.0, 0.0, 4.0));
  EXPECT_EQ(both[0].return_type, ReturnType::kLast);
  EXPECT_EQ(both[1].return_type, ReturnType::kStrongest);
  const std::vector<Point> same = pair_of(0x3B, 1500, 1500);
  ASSERT_EQ(same.size(), 1U);
  EXPECT_EQ(same[0].return_type, ReturnType::kBoth);
  // The first return is in the odd block; the strongest, in the even block, is the farther one.
  const std::vector<Point> first = pair_of(0x3C, 1000, 2000);
  ASSERT_EQ(first.size(), 2U);
  EXPECT_EQ(first[0].return_type, ReturnType::kLast);
  EXPECT_EQ(first[0].intensity, 20.0F);
  ASSERT_EQ(pair_of(0x3C, 1000, 2000, DualReturns::kLast).size(), 1U);
  EXPECT_EQ(pair_of(0x3C, 1000, 2000, DualReturns::kLast)[0].intensity, 20.0F);
  EXPECT_EQ(pair_of(0x3C, 1000, 2000, DualReturns::kLast)[0].return_type, ReturnType::kBoth);
  EXPECT_EQ(pair_of(0x39, 2000, 1000, DualReturns::kStrongest)[0].intensity, 20.0F);
  EXPECT_EQ(pair_of(0x39, 0, 1000).size(), 1U);
}

TEST(HesaiDecoder, DualPacketsTakeHalfOfTheTime) {
  Bytes bytes = packet(32, 0x39, kTimeUs, 10.0, kStepDeg);
  set_cell(bytes, 32, 6, 0, 1000, 1);
  const auto decoder = decoder_for(bytes);
  const std::vector<Point> points = decode_all(*decoder, bytes);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_NEAR(1e-3 * points[0].time_ns + static_cast<double>(decoder->tail(bytes).toh_us) - kTimeUs,
              6.0, 1e-3);
  EXPECT_EQ(decoder->packet_period_ns(ReturnMode::kDual), 200'000);
  EXPECT_EQ(decoder->packet_period_ns(ReturnMode::kStrongest), 400'000);
}

TEST(HesaiDecoder, RangeLimitsBelongToTheRange) {
  Bytes bytes = packet(32, 0x37, kTimeUs, 0.0, kStepDeg);
  const std::array<unsigned, 5> raws = {249, 250, 1000, 2500, 2501};
  for (int i = 0; i < 5; ++i) {
    set_cell(bytes, 32, i, 0, raws[static_cast<std::size_t>(i)], 1);
  }
  DecodingOptions options;
  options.min_range_m = 1.0;
  options.max_range_m = 10.0;
  EXPECT_EQ(decode_all(*decoder_for(bytes, options), bytes).size(), 3U);
}

TEST(HesaiDecoder, DamagedPacketsAreRejectedByReason) {
  const Bytes good = packet(32, 0x37, kTimeUs, 0.0, kStepDeg);
  const auto decoder = decoder_for(good);
  const auto reject_of = [&](const auto& change) {
    Bytes bytes = good;
    change(bytes);
    return decoder->tail(bytes).reject;
  };
  EXPECT_EQ(reject_of([](Bytes& b) { b.resize(700); }), Reject::kShort);
  EXPECT_EQ(reject_of([](Bytes& b) { b.push_back(0); }), Reject::kForeign);
  EXPECT_EQ(reject_of([](Bytes& b) { b[0] = 0xFF; }), Reject::kForeign);
  EXPECT_EQ(reject_of([](Bytes& b) { b[6] = 16; }), Reject::kModelMismatch);
  EXPECT_EQ(reject_of([](Bytes& b) { b[3] = 4; }), Reject::kModelMismatch);
  EXPECT_EQ(reject_of([](Bytes& b) { b[1052 + 10] = 0x40; }), Reject::kUnknownMode);
  EXPECT_EQ(reject_of([](Bytes& b) { b[1052 + 17] = 60; }), Reject::kBadTime);
  EXPECT_EQ(reject_of([](Bytes& b) { test::put_u32(b, 1052 + 19, 2'000'000); }), Reject::kBadTime);
  EXPECT_EQ(reject_of([](Bytes&) {}), Reject::kNone);
}

TEST(HesaiMaker, KnowsItsPackets) {
  const Makers makers({});
  EXPECT_EQ(makers.kind(packet(32, 0x37, 0, 0.0, kStepDeg)), PacketKind::kData);
  EXPECT_EQ(makers.kind(packet(16, 0x37, 0, 0.0, kStepDeg)), PacketKind::kData);
  EXPECT_EQ(makers.kind(Bytes(1080, 0)), PacketKind::kForeign);
  EXPECT_TRUE(is_known_model("pandarxt 32"));
}

TEST(HesaiMaker, OtherSensorsOfTheMakerAreNamed) {
  // A Pandar128: protocol 1.3, 128 lasers, two blocks.
  Bytes bytes = packet(32, 0x37, 0, 0.0, kStepDeg);
  bytes[2] = 1;
  bytes[3] = 3;
  bytes[6] = 128;
  bytes[7] = 2;
  const auto decoder = decoder_for(bytes);
  EXPECT_EQ(decoder->tail(bytes).reject, Reject::kUnknownModel);
  EXPECT_THAT(decoder->contradictions().front(),
              HasSubstr("protocol 1.3, 128 lasers, 2 blocks) that is not decoded here"));
}

TEST(HesaiMaker, TheDesignsAnglesAreSaid) {
  std::vector<std::string> remarks;
  make({})->decoder({packet(32, 0x37, 0, 0.0, kStepDeg)}, remarks);
  ASSERT_EQ(remarks.size(), 1U);
  EXPECT_THAT(remarks[0], HasSubstr("driver.metadata"));
}

TEST(HesaiMaker, AnotherModelIsSaid) {
  DecodingOptions options;
  options.model = "VLP-16";
  const Bytes bytes = packet(32, 0x37, 0, 0.0, kStepDeg);
  EXPECT_THAT(decoder_for(bytes, options)->contradictions().front(),
              HasSubstr("driver.model says VLP-16, the packets say PandarXT-32"));
  options.model = "pandarxt32";
  EXPECT_THAT(decoder_for(bytes, options)->contradictions(), IsEmpty());
}

TEST(HesaiMaker, PayloadFilesByTheUnitsAngles) {
  DecodingOptions options;
  for (int laser = 1; laser <= 16; ++laser) {
    options.metadata += std::to_string(laser) + "," + std::to_string(17 - 2 * laser) + ",0\n";
  }
  EXPECT_EQ(Makers(options).maker().payload_bytes(), 568U);
}

TEST(HesaiMaker, PayloadFilesByTheModel) {
  DecodingOptions options;
  options.model = "PandarXT-16";
  EXPECT_EQ(Makers(options).maker().payload_bytes(), 568U);
}

}  // namespace
}  // namespace zloam::driver::hesai
