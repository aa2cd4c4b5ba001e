#include "driver/decoder/nmea.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <vector>

namespace zloam::driver {
namespace {

std::vector<std::string_view> split(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  while (true) {
    const std::size_t end = text.find(separator);
    parts.push_back(text.substr(0, end));
    if (end == std::string_view::npos) return parts;
    text.remove_prefix(end + 1);
  }
}

/// Parses digits with at most one point; nothing for any other text.
std::optional<double> number(std::string_view text) {
  const auto is_part = [](char c) { return c == '.' || (c >= '0' && c <= '9'); };
  if (!std::all_of(text.begin(), text.end(), is_part)) return std::nullopt;
  double value = 0.0;
  const char* end = text.data() + text.size();
  const auto read = std::from_chars(text.data(), end, value, std::chars_format::fixed);
  if (read.ec != std::errc() || read.ptr != end) return std::nullopt;
  return value;
}

/// Converts ddmm.mmmm or dddmm.mmmm to degrees.
std::optional<double> degrees(std::string_view text, std::string_view hemisphere) {
  const auto value = number(text);
  if (!value || *value > 18000.0) return std::nullopt;
  const double whole = std::floor(*value / 100.0);
  const double result = whole + (*value - 100.0 * whole) / 60.0;
  return hemisphere == "S" || hemisphere == "W" ? -result : result;
}

/// Days since 1970-01-01 in the Gregorian calendar (H. Hinnant, chrono-compatible date algorithms).
std::int64_t days_from_civil(int year, int month, int day) {
  year -= month <= 2;
  const int era = year / 400;
  const int year_of_era = year - era * 400;
  const int day_of_year = (153 * (month + (month > 2 ? -3 : 9)) + 2) / 5 + day - 1;
  const int day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
  return static_cast<std::int64_t>(era) * 146097 + day_of_era - 719468;
}

/// Converts ddmmyy and hhmmss.sss to ns since the Unix epoch; 0 if either is invalid.
std::int64_t utc_ns(std::string_view date, std::string_view time) {
  const auto day_number = number(date);
  const auto time_number = number(time);
  if (!day_number || !time_number || date.size() != 6 || *time_number >= 240000.0) return 0;
  const int d = static_cast<int>(*day_number);
  const int day = d / 10000;
  const int month = d / 100 % 100;
  if (day < 1 || day > 31 || month < 1 || month > 12) return 0;
  const int hms = static_cast<int>(*time_number);
  if (hms / 100 % 100 > 59 || hms % 100 > 60) return 0;
  const double seconds = *time_number - hms + hms % 100;
  const int minutes = hms / 10000 * 60 + hms / 100 % 100;
  const std::int64_t whole_min = days_from_civil(2000 + d % 100, month, day) * 1440 + minutes;
  return whole_min * 60'000'000'000 + std::llround(seconds * 1e9);
}

int hex_value(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  return -1;
}

/// The sentence between '$' and '*' if its checksum is right. Line ends and padding are optional.
std::optional<std::string_view> checked_body(std::string_view sentence) {
  const std::size_t star = sentence.find('*');
  if (sentence.empty() || sentence[0] != '$' || star == std::string_view::npos) return std::nullopt;
  if (star + 2 >= sentence.size()) return std::nullopt;
  const std::string_view body = sentence.substr(1, star - 1);
  int sum = 0;
  for (const char c : body) sum ^= static_cast<unsigned char>(c);
  const int high = hex_value(sentence[star + 1]);
  const int low = hex_value(sentence[star + 2]);
  if (high < 0 || low < 0 || sum != high * 16 + low) return std::nullopt;
  return body;
}

}  // namespace

std::optional<NmeaFix> parse_rmc(std::string_view sentence) {
  const auto body = checked_body(sentence);
  if (!body) return std::nullopt;
  const std::vector<std::string_view> fields = split(*body, ',');
  if (fields.size() < 10 || fields[0].size() != 5 || fields[0].substr(2) != "RMC") {
    return std::nullopt;
  }
  NmeaFix fix;
  fix.utc_ns = utc_ns(fields[9], fields[1]);
  fix.valid = fields[2] == "A";
  const auto latitude = degrees(fields[3], fields[4]);
  const auto longitude = degrees(fields[5], fields[6]);
  if (latitude && longitude) {
    fix.latitude_deg = *latitude;
    fix.longitude_deg = *longitude;
  } else {
    fix.valid = false;
  }
  return fix;
}

bool agrees_with_utc(std::uint32_t toh_us, std::int64_t utc_ns) {
  if (utc_ns == 0) return true;
  constexpr std::int64_t kHourNs = 3'600'000'000'000;
  constexpr std::int64_t kToleranceNs = 2'000'000'000;
  const std::int64_t apart_ns =
      ((1000 * static_cast<std::int64_t>(toh_us) - utc_ns) % kHourNs + kHourNs) % kHourNs;
  return std::min(apart_ns, kHourNs - apart_ns) < kToleranceNs;
}

}  // namespace zloam::driver
