#include "driver/io/imu_file.hpp"

#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <string_view>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::array<std::string_view, 7> kColumns = {"t_ns",    "wx_rad_s", "wy_rad_s", "wz_rad_s",
                                                      "ax_m_s2", "ay_m_s2",  "az_m_s2"};

std::vector<std::string_view> fields_of(std::string_view line) {
  std::vector<std::string_view> fields;
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  for (;;) {
    const std::size_t comma = line.find(',');
    fields.push_back(line.substr(0, comma));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

template <class Number>
Number number_of(std::string_view text, const std::string& where, std::string_view column) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size()) {
    throw SourceError(where + ": " + std::string(column) + ": \"" + std::string(text) +
                      "\" is no number");
  }
  return value;
}

// Where each of kColumns stands.
std::array<std::size_t, kColumns.size()> places_of(std::string_view names,
                                                   const std::string& where) {
  const std::vector<std::string_view> fields = fields_of(names);
  std::array<std::size_t, kColumns.size()> places{};
  for (std::size_t c = 0; c < kColumns.size(); ++c) {
    std::size_t place = 0;
    while (place < fields.size() && fields[place] != kColumns[c]) ++place;
    if (place == fields.size()) {
      throw SourceError(where + ": no column " + std::string(kColumns[c]) +
                        " in the line of names");
    }
    places[c] = place;
  }
  return places;
}

}  // namespace

std::vector<ImuReading> read_imu_file(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!file || !std::getline(file, line)) {
    throw SourceError(path + ": " + (file.eof() ? "is empty" : std::strerror(errno)));
  }
  const auto places = places_of(line, path + ":1");
  std::vector<ImuReading> readings;
  for (int number = 2; std::getline(file, line); ++number) {
    if (line.empty()) continue;
    const std::string where = path + ":" + std::to_string(number);
    const std::vector<std::string_view> fields = fields_of(line);
    std::array<double, kColumns.size()> values{};
    ImuReading reading;
    for (std::size_t c = 0; c < kColumns.size(); ++c) {
      if (places[c] >= fields.size()) {
        throw SourceError(where + ": has no " + std::string(kColumns[c]));
      }
      const std::string_view text = fields[places[c]];
      if (c == 0) {
        reading.stamp_ns = number_of<std::int64_t>(text, where, kColumns[c]);
      } else {
        values[c] = number_of<double>(text, where, kColumns[c]);
        if (!std::isfinite(values[c])) {
          throw SourceError(where + ": " + std::string(kColumns[c]) + " is not finite");
        }
      }
    }
    reading.rate_radps = {values[1], values[2], values[3]};
    reading.force_mps2 = {values[4], values[5], values[6]};
    readings.push_back(reading);
  }
  if (readings.empty()) throw SourceError(path + ": holds no reading");
  return readings;
}

}  // namespace zloam::driver
