#include "driver/io/imu_file.hpp"

#include <algorithm>
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
constexpr std::string_view kBlanks = " \t\r\"'";
// An inertial sensor reads so often: what is outside is of another unit.
constexpr double kMostReadings_hz = 20'000.0;
constexpr double kFewestReadings_hz = 0.5;

std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

/// How the table is written: told by the line of names.
class Table {
 public:
  Table(std::string_view names, const std::string& where) : names_(names) {
    if (names.find(',') == std::string_view::npos) {
      separator_ = names.find(';') != std::string_view::npos ? ';' : '\t';
    }
    if (names.starts_with('#')) names.remove_prefix(1);
    const std::vector<std::string_view> fields = fields_of(names);
    for (std::size_t c = 0; c < kColumns.size(); ++c) {
      const auto place = std::find(fields.begin(), fields.end(), kColumns[c]);
      if (place == fields.end()) {
        throw SourceError(where + ": no column " + std::string(kColumns[c]) +
                          " in the line of names");
      }
      places_[c] = static_cast<std::size_t>(place - fields.begin());
    }
  }

  /// Nothing for a line that holds no reading: empty, a comment, the names once more.
  bool read(std::string_view line, const std::string& where, ImuReading& reading) const {
    const std::string_view text = trimmed(line);
    if (text.empty() || text.starts_with('#') || text == trimmed(names_)) return false;
    const std::vector<std::string_view> fields = fields_of(line);
    std::array<double, kColumns.size()> values{};
    for (std::size_t c = 0; c < kColumns.size(); ++c) {
      if (places_[c] >= fields.size()) {
        throw SourceError(where + ": has no " + std::string(kColumns[c]));
      }
      const std::string_view field = fields[places_[c]];
      if (c == 0) {
        reading.stamp_ns = stamp(field, where);
      } else {
        values[c] = number(field, where, kColumns[c]);
      }
    }
    reading.rate_radps = {values[1], values[2], values[3]};
    reading.force_mps2 = {values[4], values[5], values[6]};
    return true;
  }

 private:
  std::vector<std::string_view> fields_of(std::string_view line) const {
    std::vector<std::string_view> fields;
    for (;;) {
      const std::size_t end = line.find(separator_);
      fields.push_back(trimmed(line.substr(0, end)));
      if (end == std::string_view::npos) return fields;
      line.remove_prefix(end + 1);
    }
  }

  template <class Number>
  static bool parse(std::string_view text, Number& value) {
    if (text.starts_with('+')) text.remove_prefix(1);
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc{} && end == text.data() + text.size();
  }

  static std::int64_t stamp(std::string_view text, const std::string& where) {
    std::int64_t stamp_ns = 0;
    if (parse(text, stamp_ns)) return stamp_ns;
    double other = 0.0;
    const bool number = parse(text, other);
    throw SourceError(where + ": t_ns: \"" + std::string(text) +
                      (number ? "\" is no whole number of nanoseconds" : "\" is no number"));
  }

  double number(std::string_view text, const std::string& where, std::string_view column) const {
    // Where commas part no fields they may be decimal ones.
    std::string decimal(text);
    if (separator_ != ',') std::replace(decimal.begin(), decimal.end(), ',', '.');
    double value = 0.0;
    if (!parse<double>(decimal, value)) {
      throw SourceError(where + ": " + std::string(column) + ": \"" + std::string(text) +
                        "\" is no number");
    }
    if (!std::isfinite(value)) {
      throw SourceError(where + ": " + std::string(column) + " is not finite");
    }
    return value;
  }

  std::string names_;
  char separator_ = ',';
  std::array<std::size_t, kColumns.size()> places_{};
};

/// The rate tells the unit of the stamps, and the order how the file was sorted.
void refuse_wrong_stamps(const std::string& path, const std::vector<ImuReading>& readings) {
  std::vector<std::int64_t> steps_ns;
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const std::int64_t step_ns = readings[i].stamp_ns - readings[i - 1].stamp_ns;
    if (step_ns != 0) steps_ns.push_back(step_ns);
  }
  if (steps_ns.empty()) return;
  const auto middle = steps_ns.begin() + static_cast<std::ptrdiff_t>(steps_ns.size() / 2);
  std::nth_element(steps_ns.begin(), middle, steps_ns.end());
  if (*middle < 0) throw SourceError(path + ": the stamps descend: sort the lines by t_ns");
  const double rate_hz = 1e9 / static_cast<double>(*middle);
  if (rate_hz <= kMostReadings_hz && rate_hz >= kFewestReadings_hz) return;
  std::string unit;
  for (const auto& [factor, name] : {std::pair{1e3, "us"}, {1e6, "ms"}, {1e9, "s"}}) {
    const bool fits = rate_hz / factor <= kMostReadings_hz && rate_hz / factor >= 1.0;
    if (fits && unit.empty()) unit = std::string(", as if they were ") + name;
  }
  throw SourceError(path + ": its stamps are " + std::to_string(*middle) +
                    " apart: t_ns is in nanoseconds" + unit);
}

}  // namespace

std::vector<ImuReading> read_imu_file(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!file || !std::getline(file, line)) {
    throw SourceError(path + ": " + (file.eof() ? "is empty" : std::strerror(errno)));
  }
  if (line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
  if (line.starts_with("\xFF\xFE") || line.starts_with("\xFE\xFF")) {
    throw SourceError(path + ": is UTF-16; UTF-8 is expected");
  }
  const Table table(line, path + ":1");
  std::vector<ImuReading> readings;
  ImuReading reading;
  for (int number = 2; std::getline(file, line); ++number) {
    if (table.read(line, path + ":" + std::to_string(number), reading)) readings.push_back(reading);
  }
  if (readings.empty()) throw SourceError(path + ": holds no reading");
  refuse_wrong_stamps(path, readings);
  return readings;
}

std::string standstill_in(const std::vector<ImuReading>& readings) {
  // Noise alone changes a reading; a simulated one without noise stands still while the platform
  // does, and says so from its start.
  constexpr std::size_t kSame = 50;
  std::size_t same = 0;
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const bool equal = readings[i].rate_radps == readings[i - 1].rate_radps &&
                       readings[i].force_mps2 == readings[i - 1].force_mps2 &&
                       readings[i].stamp_ns != readings[i - 1].stamp_ns;
    same = equal ? same + 1 : 0;
    if (same == kSame && i > kSame) {
      return "the readings are the same for " + std::to_string(kSame) + " times in a row from " +
             std::to_string(readings[i - kSame].stamp_ns) + " ns on: did the sensor hang?";
    }
  }
  return {};
}

}  // namespace zloam::driver
