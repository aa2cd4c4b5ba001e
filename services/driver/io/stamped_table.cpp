#include "driver/io/stamped_table.hpp"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::string_view kBlanks = " \t\r\"'";

std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

/// The table's separator and columns, determined from the line of names.
class Table {
 public:
  Table(std::string_view names, const std::vector<std::string_view>& columns,
        const std::string& where)
      : names_(names), columns_(columns) {
    if (names.find(',') == std::string_view::npos) {
      separator_ = names.find(';') != std::string_view::npos ? ';' : '\t';
    }
    if (names.starts_with('#')) names.remove_prefix(1);
    const std::vector<std::string_view> fields = fields_of(names);
    for (const std::string_view column : columns_) {
      const auto place = std::find(fields.begin(), fields.end(), column);
      if (place == fields.end()) {
        throw SourceError(where + ": no column " + std::string(column) + " in the line of names");
      }
      places_.push_back(static_cast<std::size_t>(place - fields.begin()));
    }
  }

  /// False for a line without a reading: empty, a comment, or the names repeated.
  bool read(std::string_view line, const std::string& where, StampedRow& row) const {
    const std::string_view text = trimmed(line);
    if (text.empty() || text.starts_with('#') || text == trimmed(names_)) return false;
    const std::vector<std::string_view> fields = fields_of(line);
    row.values.clear();
    for (std::size_t c = 0; c < columns_.size(); ++c) {
      if (places_[c] >= fields.size()) {
        throw SourceError(where + ": has no " + std::string(columns_[c]));
      }
      const std::string_view field = fields[places_[c]];
      if (c == 0) {
        row.stamp_ns = stamp(field, where);
      } else {
        row.values.push_back(number(field, where, columns_[c]));
      }
    }
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

  std::int64_t stamp(std::string_view text, const std::string& where) const {
    std::int64_t stamp_ns = 0;
    if (parse(text, stamp_ns)) return stamp_ns;
    double other = 0.0;
    const bool number = parse(text, other);
    throw SourceError(where + ": " + std::string(columns_[0]) + ": \"" + std::string(text) +
                      (number ? "\" is no whole number of nanoseconds" : "\" is no number"));
  }

  double number(std::string_view text, const std::string& where, std::string_view column) const {
    // If commas do not separate the fields, they may be decimal points.
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
  std::vector<std::string_view> columns_;
  std::vector<std::size_t> places_;
};

}  // namespace

std::vector<StampedRow> read_stamped_table(const std::string& path,
                                           const std::vector<std::string_view>& columns) {
  std::ifstream file(path);
  std::string line;
  if (!file || !std::getline(file, line)) {
    throw SourceError(path + ": " + (file.eof() ? "is empty" : std::strerror(errno)));
  }
  if (line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
  if (line.starts_with("\xFF\xFE") || line.starts_with("\xFE\xFF")) {
    throw SourceError(path + ": is UTF-16; UTF-8 is expected");
  }
  const Table table(line, columns, path + ":1");
  std::vector<StampedRow> rows;
  StampedRow row;
  for (int number = 2; std::getline(file, line); ++number) {
    if (table.read(line, path + ":" + std::to_string(number), row)) rows.push_back(row);
  }
  return rows;
}

}  // namespace zloam::driver
