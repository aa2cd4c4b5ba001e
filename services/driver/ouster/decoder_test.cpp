// Packets made by the manual's "Sensor Data", decoded and compared with the manual's formulas.
#include "driver/ouster/decoder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "driver/decoder/test_decoding.hpp"
#include "driver/ouster/imu_packet.hpp"
#include "driver/ouster/ouster.hpp"
#include "driver/ouster/test_sensor.hpp"

namespace zloam::driver::ouster {
namespace {

using driver::test::decode_all;
using test::Bytes;
using test::Description;
using test::empty_packet;
using test::pixel_at;
using test::put;
using ::testing::HasSubstr;

constexpr std::uint64_t kTimeNs = 991'587'364'521;

/// The manual's "Lidar Range Data To Sensor XYZ Coordinate Frame", result in m.
Eigen::Vector3d by_the_manual(int column, int pixel, double range_mm) {
  const double encoder = 2.0 * std::numbers::pi * (1.0 - column / 1024.0);
  const double azimuth = -2.0 * std::numbers::pi * Description::azimuth_deg(pixel) / 360.0;
  const double altitude = 2.0 * std::numbers::pi * Description::altitude_deg(pixel) / 360.0;
  const double n = std::hypot(15.8, 4.2);
  const double r = range_mm - n;
  const Eigen::Vector3d lidar(
      r * std::cos(encoder + azimuth) * std::cos(altitude) + 15.8 * std::cos(encoder),
      r * std::sin(encoder + azimuth) * std::cos(altitude) + 15.8 * std::sin(encoder),
      r * std::sin(altitude) + 4.2);
  return 1e-3 * Eigen::Vector3d(-lidar.x(), -lidar.y(), lidar.z() + 36.18);
}

void expect_at(const Point& point, const Eigen::Vector3d& expected_m) {
  EXPECT_LT((point.position().cast<double>() - expected_m).norm(),
            2e-6 + 1.2e-7 * expected_m.norm());
}

TEST(OusterDecoder, OneReturn19Bits) {
  const Metadata metadata = Description{}.metadata();
  Bytes packet = empty_packet(metadata, 272, kTimeNs);
  // The bits of the word above the 19 bits of range are flags.
  put<std::uint32_t>(packet, pixel_at(metadata, 0, 0), 0xFFF80000U | 12345);
  packet[pixel_at(metadata, 0, 0) + 4] = 77;
  put<std::uint32_t>(packet, pixel_at(metadata, 15, 3), 500'000);
  packet[pixel_at(metadata, 15, 3) + 4] = 255;
  Decoder decoder(metadata, {});
  const std::vector<Point> points = decode_all(decoder, packet);
  ASSERT_EQ(points.size(), 2U);
  expect_at(points[0], by_the_manual(272, 0, 12345.0));
  expect_at(points[1], by_the_manual(287, 3, 500'000.0));
  EXPECT_EQ(points[0].ring, 15);
  EXPECT_EQ(points[1].ring, 12);
  EXPECT_EQ(points[0].intensity, 77.0F);
  EXPECT_EQ(points[1].intensity, 255.0F);
  EXPECT_EQ(points[0].return_type, ReturnType::kStrongest);
  // The stamp is in whole microseconds; the column's time has 521 ns more.
  EXPECT_EQ(points[0].time_ns, 521U);
  EXPECT_NEAR(points[1].time_ns, 521 + 15 * 97656.25, 1.0);
  EXPECT_EQ(decoder.tail(packet).toh_us, 991'587'364U);
  // Column 272 of 1024, counted clockwise from the rear.
  EXPECT_NEAR(decoder.tail(packet).first_azimuth_cdeg, 18000 + 9562.5, 0.51);
}

TEST(OusterDecoder, OneReturn15BitsOfEightMillimetres) {
  Description description;
  description.profile = "RNG15_RFL8_NIR8";
  const Metadata metadata = description.metadata();
  Bytes packet = empty_packet(metadata, 0, kTimeNs);
  put<std::uint32_t>(packet, pixel_at(metadata, 0, 15), 0x11FE8000U | 1000);
  Decoder decoder(metadata, {});
  const std::vector<Point> points = decode_all(decoder, packet);
  ASSERT_EQ(points.size(), 1U);
  expect_at(points[0], by_the_manual(0, 15, 8000.0));
  EXPECT_EQ(points[0].intensity, 254.0F);
  EXPECT_EQ(points[0].ring, 0);
}

TEST(OusterDecoder, LegacyHasItsStatusBehindThePixels) {
  Description description;
  description.profile = "LEGACY";
  const Metadata metadata = description.metadata();
  Bytes packet = empty_packet(metadata, 512, kTimeNs);
  put<std::uint32_t>(packet, pixel_at(metadata, 7, 8), 0xF0000000U | 1'000'000);
  packet[pixel_at(metadata, 7, 8) + 4] = 9;
  put<std::uint32_t>(packet, pixel_at(metadata, 8, 8), 2000);
  put<std::uint32_t>(packet, pixel_at(metadata, 9, 0) - 16 - 4, 0);  // status of column 8
  Decoder decoder(metadata, {});
  const std::vector<Point> points = decode_all(decoder, packet);
  ASSERT_EQ(points.size(), 1U);
  expect_at(points[0], by_the_manual(519, 8, 1'000'000.0));
  EXPECT_EQ(points[0].intensity, 9.0F);
  EXPECT_EQ(decoder.plan(packet, ReturnMode::kStrongest).bad_blocks, 1);
}

/// Pixels 0 to 4 with two returns: second nearer, second farther, first only, second only, both
/// equal.
std::vector<Point> dual(const std::string& return_order, DualReturns policy) {
  Description description;
  description.profile = "RNG19_RFL8_SIG16_NIR16_DUAL";
  description.return_order = return_order;
  const Metadata metadata = description.metadata();
  Bytes packet = empty_packet(metadata, 0, kTimeNs);
  const std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs_mm = {
      {9000, 4000}, {3000, 8000}, {7000, 0}, {0, 6000}, {5000, 5000}};
  for (int p = 0; p < 5; ++p) {
    const std::size_t at = pixel_at(metadata, 0, p);
    const auto [first_mm, second_mm] = pairs_mm[static_cast<std::size_t>(p)];
    const auto reflectivity = static_cast<std::uint32_t>(10 * p + 1);
    put<std::uint32_t>(packet, at, first_mm | reflectivity << 24);
    put<std::uint32_t>(packet, at + 4, second_mm | (reflectivity + 1) << 24);
  }
  Decoder decoder(metadata, {.dual_returns = policy});
  return decode_all(decoder, packet);
}

using Expect = std::vector<std::pair<int, ReturnType>>;

Expect returns_of(const std::vector<Point>& points) {
  Expect got;
  for (const Point& p : points) got.emplace_back(static_cast<int>(p.intensity), p.return_type);
  return got;
}

constexpr auto kStrongest = ReturnType::kStrongest;
constexpr auto kLast = ReturnType::kLast;
constexpr auto kBoth = ReturnType::kBoth;
constexpr auto kSecond = ReturnType::kSecondStrongest;

TEST(OusterDecoder, TwoReturnsByStrength) {
  const char* order = "STRONGEST_TO_WEAKEST";
  EXPECT_EQ(returns_of(dual(order, DualReturns::kTagged)), (Expect{{1, kBoth},
                                                                   {2, kSecond},
                                                                   {11, kStrongest},
                                                                   {12, kLast},
                                                                   {21, kBoth},
                                                                   {32, kBoth},
                                                                   {41, kBoth}}));
  EXPECT_EQ(returns_of(dual(order, DualReturns::kStrongest)),
            (Expect{{1, kBoth}, {11, kStrongest}, {21, kBoth}, {32, kBoth}, {41, kBoth}}));
  EXPECT_EQ(returns_of(dual(order, DualReturns::kLast)),
            (Expect{{1, kBoth}, {12, kBoth}, {21, kBoth}, {32, kBoth}, {41, kBoth}}));
  EXPECT_EQ(returns_of(dual(order, DualReturns::kBoth)).size(), 7U);
}

TEST(OusterDecoder, TwoReturnsByDistance) {
  for (const char* order : {"FARTHEST_TO_NEAREST", "NEAREST_TO_FARTHEST"}) {
    EXPECT_EQ(returns_of(dual(order, DualReturns::kTagged)), (Expect{{1, kLast},
                                                                     {2, kStrongest},
                                                                     {11, kStrongest},
                                                                     {12, kLast},
                                                                     {21, kBoth},
                                                                     {32, kBoth},
                                                                     {41, kBoth}}));
    EXPECT_EQ(returns_of(dual(order, DualReturns::kStrongest)),
              (Expect{{2, kStrongest}, {11, kStrongest}, {21, kBoth}, {32, kBoth}, {41, kBoth}}));
    EXPECT_EQ(returns_of(dual(order, DualReturns::kLast)),
              (Expect{{1, kBoth}, {12, kBoth}, {21, kBoth}, {32, kBoth}, {41, kBoth}}));
  }
}

TEST(OusterDecoder, RangeLimitsBelongToTheRange) {
  const Metadata metadata = Description{}.metadata();
  Bytes packet = empty_packet(metadata, 0, kTimeNs);
  const std::uint32_t ranges_mm[] = {999, 1000, 50'000, 50'001};
  for (int p = 0; p < 4; ++p) put(packet, pixel_at(metadata, 0, p), ranges_mm[p]);
  Decoder decoder(metadata, {.min_range_m = 1.0, .max_range_m = 50.0});
  EXPECT_EQ(decode_all(decoder, packet).size(), 2U);
}

TEST(OusterDecoder, InvalidColumnsAreSkippedAndCountedWithinTheWindow) {
  Description description;
  description.window = "[5, 1000]";
  const Metadata metadata = description.metadata();
  const PacketLayout layout(metadata);
  Bytes packet = empty_packet(metadata, 0, kTimeNs);
  for (const int c : {0, 1, 2, 3, 4, 9}) {
    const std::size_t at = layout.header_bytes + static_cast<std::size_t>(c) * layout.column_bytes;
    packet[at + layout.status_at] = 0;
    put<std::uint64_t>(packet, at, 0);
  }
  Decoder decoder(metadata, {});
  EXPECT_EQ(decoder.tail(packet).toh_us, 991'587'364U);
  const PacketPlan plan = decoder.plan(packet, ReturnMode::kStrongest);
  EXPECT_FALSE(plan.group[4].valid);
  EXPECT_TRUE(plan.group[5].valid);
  EXPECT_EQ(plan.bad_blocks, 1);
  EXPECT_NEAR(static_cast<double>(plan.group[5].offset_ns), 521 + 5 * 97656.25, 2.0);
}

TEST(OusterDecoder, AColumnThatDoesNotFollowIsBad) {
  const Metadata metadata = Description{}.metadata();
  const PacketLayout layout(metadata);
  Bytes packet = empty_packet(metadata, 1020, kTimeNs);
  const auto column_at = [&](int c) {
    return layout.header_bytes + static_cast<std::size_t>(c) * layout.column_bytes;
  };
  put<std::uint16_t>(packet, column_at(2) + 8, 5);
  put<std::uint16_t>(packet, column_at(3) + 8, 0xFFFF);
  put<std::uint64_t>(packet, column_at(7), kTimeNs + 5'000'000);
  put<std::uint64_t>(packet, column_at(8), 0);
  Decoder decoder(metadata, {});
  decoder.tail(packet);
  const PacketPlan plan = decoder.plan(packet, ReturnMode::kStrongest);
  EXPECT_EQ(plan.bad_blocks, 4);
  EXPECT_FALSE(plan.group[2].valid || plan.group[3].valid || plan.group[7].valid ||
               plan.group[8].valid);
  EXPECT_TRUE(plan.group[4].valid && plan.group[9].valid);  // across the frame's end
}

TEST(OusterDecoder, TheNextPacketComesBehindWhatTheWindowLeavesOut) {
  Description description;
  description.window = "[64, 511]";
  const Metadata metadata = description.metadata();
  Decoder decoder(metadata, {});
  const auto next_ns = [&](int first_column) {
    const Bytes packet = empty_packet(metadata, first_column, kTimeNs);
    decoder.tail(packet);
    return decoder.plan(packet, ReturnMode::kStrongest).next_ns;
  };
  EXPECT_EQ(next_ns(64), 1'562'500);
  EXPECT_EQ(next_ns(480), 1'562'500);
  EXPECT_EQ(next_ns(496), std::llround((1024 - 448 + 16) * 97656.25));
}

TEST(OusterDecoder, PacketsThatDoNotFitTheMetadata) {
  const Metadata metadata = Description{}.metadata();
  Decoder decoder(metadata, {});
  Bytes packet = empty_packet(metadata, 0, kTimeNs);
  put<std::uint16_t>(packet, 4, 1);  // the sensor was started again
  EXPECT_EQ(decoder.tail(packet).reject, Reject::kNone);
  ASSERT_EQ(decoder.contradictions().size(), 1U);
  EXPECT_THAT(decoder.contradictions()[0], HasSubstr("started or set up again"));
  packet[8] ^= 1;  // another sensor's serial number
  EXPECT_EQ(decoder.tail(packet).reject, Reject::kModelMismatch);
  EXPECT_THAT(decoder.contradictions().back(), HasSubstr("serial number"));
  packet.resize(packet.size() - 1);
  EXPECT_EQ(decoder.tail(packet).reject, Reject::kForeign);
  EXPECT_EQ(decoder.tail({}).reject, Reject::kForeign);
  Bytes invalid = empty_packet(metadata, 0, kTimeNs);
  const PacketLayout layout(metadata);
  for (int c = 0; c < 16; ++c) {
    invalid[layout.header_bytes + static_cast<std::size_t>(c) * layout.column_bytes +
            layout.status_at] = 0;
  }
  EXPECT_EQ(decoder.tail(invalid).reject, Reject::kBadTime);
}

TEST(OusterPackets, AreKnownByTheirColumns) {
  for (const char* profile : {"LEGACY", "RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16_DUAL"}) {
    SCOPED_TRACE(profile);
    Description description;
    description.profile = profile;
    const Metadata metadata = description.metadata();
    EXPECT_TRUE(looks_like_data(empty_packet(metadata, 0, kTimeNs)));
    EXPECT_TRUE(looks_like_data(empty_packet(metadata, 1015, kTimeNs)));
    EXPECT_FALSE(looks_like_data(Bytes(metadata.packet_bytes())));
    EXPECT_FALSE(looks_like_data(Bytes(metadata.packet_bytes(), 7)));
  }
  for (const std::size_t bytes : {0, 1, 48, 64, 512, 1206}) {
    EXPECT_FALSE(looks_like_data(Bytes(bytes)));
  }
}

TEST(OusterPackets, OtherReturnsThanTheProfilesAreRefused) {
  for (const char* profile : {"RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"}) {
    SCOPED_TRACE(profile);
    Description description;
    description.profile = profile;
    const std::size_t sent = description.metadata().profile->returns;
    for (const ReturnMode mode : {ReturnMode::kStrongest, ReturnMode::kLast, ReturnMode::kDual}) {
      DecodingOptions options;
      options.return_mode = mode;
      options.metadata = description.text();
      options.metadata_name = "sensor.json";
      const auto maker = make(options);
      EXPECT_EQ(maker->described(), returns_of(mode) == sent);
      if (maker->described()) continue;
      EXPECT_THAT(maker->metadata_error(), HasSubstr("driver.returns"));
    }
  }
}

TEST(OusterImu, LegacyReading) {
  const Metadata metadata = Description{}.metadata();
  Bytes packet(48);
  put<std::uint64_t>(packet, 0, 1);
  put<std::uint64_t>(packet, 8, kTimeNs);
  put<std::uint64_t>(packet, 16, kTimeNs + 200'000);
  const float words[] = {0.1F, -0.2F, 1.0F, 90.0F, -45.0F, 180.0F};
  std::memcpy(packet.data() + 24, words, sizeof words);
  const std::vector<ImuReading> readings = parse_imu(packet, metadata);
  ASSERT_EQ(readings.size(), 1U);
  EXPECT_EQ(readings[0].stamp_ns, static_cast<std::int64_t>(kTimeNs + 100'000));
  EXPECT_LT((readings[0].force_mps2 - Eigen::Vector3d(0.980665, -1.96133, 9.80665)).norm(), 1e-6);
  const Eigen::Vector3d rate_radps = std::numbers::pi * Eigen::Vector3d(0.5, -0.25, 1.0);
  EXPECT_LT((readings[0].rate_radps - rate_radps).norm(), 1e-6);
  Bytes other = packet;
  put<std::uint64_t>(other, 16, 0xE8A1'0000'0000'0000ULL);  // an NTP packet has the same length
  EXPECT_FALSE(is_imu_packet(other, metadata));
  other = packet;
  put<std::uint32_t>(other, 36, 0x7FC00000);  // NaN
  EXPECT_TRUE(parse_imu(other, metadata).empty());
  packet.push_back(0);
  EXPECT_TRUE(parse_imu(packet, metadata).empty());
}

TEST(OusterImu, SeveralReadingsInAPacket) {
  Description description;
  description.imu = R"("udp_profile_imu": "ACCEL32_GYRO32_NMEA")";
  const Metadata metadata = description.metadata();
  Bytes packet(32 + 100 + 8 * 36 + 32);
  ASSERT_EQ(metadata.imu_packet_bytes(), packet.size());
  for (std::size_t i = 0; i < 8; ++i) {
    const std::size_t at = 132 + 36 * i;
    put<std::uint64_t>(packet, at, kTimeNs + i);
    put<std::uint16_t>(packet, at + 10, i == 3 ? 0 : 1);
    const float words[] = {1.0F, 2.0F, 3.0F, 4.0F, 5.0F, 6.0F};
    std::memcpy(packet.data() + at + 12, words, sizeof words);
  }
  const std::vector<ImuReading> readings = parse_imu(packet, metadata);
  ASSERT_EQ(readings.size(), 7U);
  EXPECT_EQ(readings[3].stamp_ns, static_cast<std::int64_t>(kTimeNs + 4));
  EXPECT_EQ(readings[0].force_mps2, Eigen::Vector3d(1.0, 2.0, 3.0));
  EXPECT_EQ(readings[0].rate_radps, Eigen::Vector3d(4.0, 5.0, 6.0));
}

}  // namespace
}  // namespace zloam::driver::ouster
