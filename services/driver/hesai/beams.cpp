#include "driver/hesai/beams.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>

#include "driver/hesai/packet.hpp"

namespace zloam::driver::hesai {
namespace {

// The sensor's field of view is 31 degrees high, and its lasers are nearly in one vertical line.
constexpr double kMostElevationDeg = 45.0;
constexpr double kMostOffsetDeg = 10.0;

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kBlanks = " \t\r";
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

/// Removes the first line from the text and returns it, trimmed.
std::string_view take_line(std::string_view& text) {
  const std::size_t end = std::min(text.find('\n'), text.size());
  const std::string_view line = trimmed(text.substr(0, end));
  text.remove_prefix(std::min(end + 1, text.size()));
  return line;
}

/// Number, elevation and azimuth of a row; nothing if the line is not a row.
std::optional<std::array<double, 3>> row_of(std::string_view line) {
  std::array<double, 3> row;
  for (std::size_t i = 0; i < row.size(); ++i) {
    const std::size_t comma = line.find(',');
    // Further fields after the third one are ignored.
    if (i < 2 && comma == std::string_view::npos) return std::nullopt;
    std::string_view field = trimmed(line.substr(0, std::min(comma, line.size())));
    if (field.starts_with('+')) field.remove_prefix(1);
    const auto [end, error] = std::from_chars(field.data(), field.data() + field.size(), row[i]);
    if (error != std::errc() || end != field.data() + field.size()) return std::nullopt;
    line.remove_prefix(comma == std::string_view::npos ? line.size() : comma + 1);
  }
  return row;
}

std::string line_error(int number, const std::string& what) {
  return "line " + std::to_string(number) + ": " + what;
}

}  // namespace

std::vector<Beam> designed_beams(int lasers) {
  const double step_deg = 32.0 / lasers;
  std::vector<Beam> beams;
  beams.reserve(static_cast<std::size_t>(lasers));
  for (int i = 0; i < lasers; ++i) beams.push_back({15.0 - step_deg * i, 0.0});
  return beams;
}

std::int64_t laser_step_ns(int lasers) { return std::int64_t{1'512} * (kMostLasers / lasers); }

bool looks_like_angle_corrections(std::string_view text) {
  std::string_view line;
  while (line.empty() && !text.empty()) line = take_line(text);
  return std::count(line.begin(), line.end(), ',') >= 2 && line.find_first_of("{[<") == line.npos;
}

std::variant<std::vector<Beam>, std::string> parse_angle_corrections(std::string_view text) {
  std::vector<Beam> beams;
  bool header_seen = false;
  for (int number = 1; !text.empty(); ++number) {
    const std::string_view line = take_line(text);
    if (line.empty()) continue;
    const auto row = row_of(line);
    if (!row && !header_seen && beams.empty()) {
      header_seen = true;
      continue;
    }
    if (!row) return line_error(number, "laser, elevation and azimuth are expected");
    const auto [laser, elevation_deg, azimuth_deg] = *row;
    if (laser != static_cast<double>(beams.size() + 1)) {
      return line_error(number, "laser " + std::to_string(beams.size() + 1) + " is expected");
    }
    // Written so that NaN fails the condition.
    if (!(std::abs(elevation_deg) <= kMostElevationDeg &&
          std::abs(azimuth_deg) <= kMostOffsetDeg)) {
      return line_error(number, "no such angles, in degrees, has any PandarXT");
    }
    beams.push_back({elevation_deg, azimuth_deg});
  }
  const auto has_so_many = [&](int lasers) {
    return beams.size() == static_cast<std::size_t>(lasers);
  };
  if (std::none_of(kLaserCounts.begin(), kLaserCounts.end(), has_so_many)) {
    return "it has angles of " + std::to_string(beams.size()) + " lasers, not of 16 or 32";
  }
  return beams;
}

}  // namespace zloam::driver::hesai
