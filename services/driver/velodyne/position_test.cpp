#include "driver/velodyne/position.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace zloam::driver::velodyne {
namespace {

constexpr const char* kSentence =
    "$GPRMC,213504,A,3708.0000,N,12139.0000,W,000.0,080.5,100918,013.3,E,D*04";

std::vector<std::uint8_t> telemetry(const std::string& sentence) {
  std::vector<std::uint8_t> payload(512, 0);
  const std::vector<std::uint8_t> words = {0x0a, 0x00, 0x14, 0x00, 0x33, 0x03, 0xcd, 0x0f,
                                           0xf6, 0x0f, 0x00, 0x00, 0x01, 0x00, 0xff, 0x0f,
                                           0xff, 0x07, 0x00, 0x08, 0x00, 0x00, 0x00, 0x08};
  std::copy(words.begin(), words.end(), payload.begin() + 14);
  const std::vector<std::uint8_t> time = {0x7b, 0x7e, 0x68, 0x7d, 0x02};
  std::copy(time.begin(), time.end(), payload.begin() + 198);
  std::copy(sentence.begin(), sentence.end(), payload.begin() + 206);
  return payload;
}

TEST(Position, T1Telemetry) {
  const auto packet = parse_position(telemetry(std::string(kSentence) + "\r\n"));
  ASSERT_TRUE(packet);
  EXPECT_EQ(packet->toh_us, 2104000123U);
  EXPECT_EQ(packet->pps, Pps::kLocked);
  EXPECT_EQ(packet->nmea, kSentence);
  const double gyro[] = {0.97660, -0.97660, 199.91002};
  const double temperature[] = {27.9060, 25.0000, -272.5744};
  const double accel_x[] = {0.999999, 0.001221, 0.0};
  const double accel_y[] = {-0.062271, -0.001221, -2.500608};
  for (std::size_t i = 0; i < 3; ++i) {
    SCOPED_TRACE(i);
    EXPECT_NEAR(packet->inertial[i].gyro_dps, gyro[i], 1e-5);
    EXPECT_NEAR(packet->inertial[i].temperature_c, temperature[i], 1e-4);
    EXPECT_NEAR(packet->inertial[i].accel_x_g, accel_x[i], 1e-6);
    EXPECT_NEAR(packet->inertial[i].accel_y_g, accel_y[i], 1e-6);
  }
}

TEST(Position, OtherLengthsAreRefused) {
  EXPECT_FALSE(parse_position(std::vector<std::uint8_t>(511)));
  EXPECT_FALSE(parse_position({}));
}

TEST(Position, PpsBeyondTheTableIsAnError) {
  auto payload = telemetry("");
  payload[202] = 200;
  EXPECT_EQ(parse_position(payload)->pps, Pps::kError);
}

TEST(Nmea, RmcOfTheTelemetryVector) {
  const auto fix = parse_rmc(kSentence);
  ASSERT_TRUE(fix);
  EXPECT_TRUE(fix->valid);
  EXPECT_EQ(fix->utc_ns, 1536615304'000'000'000);  // 2018-09-10 21:35:04 UTC
  EXPECT_NEAR(fix->latitude_deg, 37.133333, 1e-6);
  EXPECT_NEAR(fix->longitude_deg, -121.65, 1e-9);
}

TEST(Nmea, LineEndIsNotNeededAndDoesNoHarm) {
  EXPECT_TRUE(parse_rmc(std::string(kSentence) + "\r\n"));
}

TEST(Nmea, RefusesWhatItCannotTrust) {
  EXPECT_FALSE(parse_rmc(""));
  EXPECT_FALSE(parse_rmc("$"));
  EXPECT_FALSE(parse_rmc("$GPRMC*"));
  EXPECT_FALSE(parse_rmc("$GPRMC,213504,A*0"));
  std::string wrong_sum = kSentence;
  wrong_sum.back() = '5';
  EXPECT_FALSE(parse_rmc(wrong_sum));
  EXPECT_FALSE(parse_rmc("$GPGGA,213504*4E"));
}

TEST(Nmea, NumbersBeyondTheirRangeAreNoFix) {
  const auto fix = parse_rmc(
      "$GPRMC,20001003504,A,9999999999999999999999999999999999999999.0,N,12139.0000,W,0,0,100918,,*"
      "07");
  ASSERT_TRUE(fix);
  EXPECT_EQ(fix->utc_ns, 0);
  EXPECT_FALSE(fix->valid);
}

// Found by fuzzing: numbers with more digits than a double can hold must not become NaN.
TEST(Nmea, NumbersOfHundredsOfDigitsAreReadOrLeftOut) {
  const std::string zeros(400, '0');
  const auto sentence = [](const std::string& latitude) {
    const std::string body = "GPRMC,213504,A," + latitude + ",N,12153.8450,W,000.0,000.0,230394,,";
    int sum = 0;
    for (const char c : body) sum ^= static_cast<unsigned char>(c);
    constexpr const char* kDigits = "0123456789ABCDEF";
    return "$" + body + "*" + kDigits[sum >> 4] + kDigits[sum & 15];
  };
  const auto precise = parse_rmc(sentence("3708.5" + zeros));
  if (!precise) GTEST_FAIL() << "the checksum of this sentence is right";
  EXPECT_NEAR(precise->latitude_deg, 37.0 + 8.5 / 60.0, 1e-12);
  const auto huge = parse_rmc(sentence("9" + zeros));
  if (!huge) GTEST_FAIL() << "the checksum of this sentence is right";
  EXPECT_EQ(huge->latitude_deg, 0.0);
  EXPECT_EQ(huge->longitude_deg, 0.0);
}

TEST(Nmea, AVoidFixHasATimeButIsNotValid) {
  const auto fix = parse_rmc("$GPRMC,120000.50,V,,,,,,,010100,,*19");
  if (!fix) GTEST_FAIL() << "the checksum of this sentence is right";
  EXPECT_FALSE(fix->valid);
  EXPECT_EQ(fix->utc_ns, 946728000'500'000'000);
}

TEST(Position, TheSensorsHourIsComparedWithTheSentence) {
  // 2018-09-10 21:35:04 UTC.
  const std::int64_t utc_ns = 1'536'615'304'000'000'000;
  EXPECT_TRUE(agrees_with_utc(2'104'000'123U, utc_ns));
  EXPECT_TRUE(agrees_with_utc(2'105'500'000U, utc_ns)) << "the sentence is of the second before";
  EXPECT_FALSE(agrees_with_utc(2'107'000'000U, utc_ns));
  EXPECT_FALSE(agrees_with_utc(404'000'000U, utc_ns));
  EXPECT_TRUE(agrees_with_utc(3'599'500'000U, 1'536'613'200'000'000'000)) << "across the hour";
  EXPECT_TRUE(agrees_with_utc(1U, 0)) << "no date, nothing to compare";
}

}  // namespace
}  // namespace zloam::driver::velodyne
