#include "simulator/vlp16.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "simulator/calendar.hpp"

namespace zloam::simulator::vlp16 {
namespace {

constexpr std::size_t kBlockBytes = 100;
constexpr std::size_t kStampOffset = 1200;
constexpr std::size_t kModeOffset = 1204;
constexpr std::size_t kProductOffset = 1205;
constexpr std::size_t kPositionStampOffset = 198;
constexpr std::size_t kPpsOffset = 202;
constexpr std::size_t kNmeaOffset = 206;

template <typename Bytes>
void put(Bytes& bytes, std::size_t offset, std::uint32_t value, int size) {
  for (int i = 0; i < size; ++i) {
    bytes[offset + static_cast<std::size_t>(i)] = static_cast<std::uint8_t>(value >> (8 * i));
  }
}

std::uint32_t microseconds_of_hour(std::int64_t unix_ns) {
  const std::int64_t within = ((unix_ns % kHourNs) + kHourNs) % kHourNs;
  return static_cast<std::uint32_t>(within / 1000);
}

// An angle in NMEA's notation: whole degrees, then minutes.
std::string nmea_angle(double degrees, int width, char positive, char negative) {
  const double magnitude = std::abs(degrees);
  auto whole = static_cast<int>(magnitude);
  auto minutes_1e4 = static_cast<long>(std::lround((magnitude - whole) * 60.0 * 1e4));
  if (minutes_1e4 == 600000) {
    ++whole;
    minutes_1e4 = 0;
  }
  char text[96];
  std::snprintf(text, sizeof text, "%0*d%02ld.%04ld,%c", width, whole, minutes_1e4 / 10000,
                minutes_1e4 % 10000, degrees < 0.0 ? negative : positive);
  return text;
}

}  // namespace

DataBytes empty_packet(ReturnMode mode) {
  DataBytes bytes{};
  for (std::size_t block = 0; block < kBlocks; ++block) {
    put(bytes, block * kBlockBytes, 0xEEFF, 2);
  }
  bytes[kModeOffset] = static_cast<std::uint8_t>(mode);
  bytes[kProductOffset] = kProduct;
  return bytes;
}

void set_azimuth(DataBytes& bytes, int block, double azimuth_deg) {
  const long hundredths = std::lround(azimuth_deg * 100.0) % 36000;
  put(bytes, static_cast<std::size_t>(block) * kBlockBytes + 2,
      static_cast<std::uint32_t>(hundredths < 0 ? hundredths + 36000 : hundredths), 2);
}

void set_return(DataBytes& bytes, int block, int channel, std::uint16_t counts,
                std::uint8_t reflectivity) {
  const std::size_t offset =
      static_cast<std::size_t>(block) * kBlockBytes + 4 + 3 * static_cast<std::size_t>(channel);
  put(bytes, offset, counts, 2);
  bytes[offset + 2] = reflectivity;
}

void set_stamp(DataBytes& bytes, std::int64_t unix_ns) {
  put(bytes, kStampOffset, microseconds_of_hour(unix_ns), 4);
}

std::string gprmc(const Position& position) {
  constexpr std::int64_t kDayS = 86'400;
  const std::int64_t now_s = position.unix_ns / 1'000'000'000;
  const Date date = date_from_days(now_s / kDayS);
  const auto clock_s = static_cast<int>(now_s % kDayS);
  char body[320];
  std::snprintf(body, sizeof body, "GPRMC,%02d%02d%02d,A,%s,%s,%05.1f,%05.1f,%02d%02d%02d,,,D",
                clock_s / 3600, clock_s / 60 % 60, clock_s % 60,
                nmea_angle(position.latitude_deg, 2, 'N', 'S').c_str(),
                nmea_angle(position.longitude_deg, 3, 'E', 'W').c_str(),
                position.speed_m_s * 3600.0 / 1852.0, position.course_deg, date.day, date.month,
                date.year % 100);
  unsigned checksum = 0;
  for (const char* c = body; *c != '\0'; ++c) {
    checksum ^= static_cast<unsigned char>(*c);
  }
  char sentence[400];
  std::snprintf(sentence, sizeof sentence, "$%s*%02X\r\n", body, checksum);
  return sentence;
}

PositionBytes position_packet(const Position& position) {
  PositionBytes bytes{};
  put(bytes, kPositionStampOffset, microseconds_of_hour(position.unix_ns), 4);
  bytes[kPpsOffset] = static_cast<std::uint8_t>(position.pps);
  const std::string sentence = gprmc(position);
  std::copy(sentence.begin(), sentence.end(), bytes.begin() + kNmeaOffset);
  return bytes;
}

}  // namespace zloam::simulator::vlp16
