#include "driver/io/scan_list.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <string_view>
#include <tuple>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostDigits = 18;
// If fewer than about half of the numbers in their range have a file, they are not scan numbers.
constexpr std::uint64_t kMostPerScan = 2;
constexpr std::uint64_t kFewScans = 10;
constexpr std::uint64_t kMostSpan = 10'000'000;
// Names can be times if their median step is within these multiples of the period.
constexpr double kLeastPeriods = 0.2;
constexpr double kMostPeriods = 5.0;
constexpr double kMostPeriodsOfTimes = 200.0;
// Beyond this, nanoseconds do not fit in 64 bits.
constexpr double kLatestS = 9e9;

/// A file name, split at its last number.
struct Name {
  std::string path;
  std::string stem;
  std::string before;
  /// without leading zeros
  std::string whole;
  std::string fraction;
  std::string after;
  bool numbered = false;
};

bool is_digit(char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; }

std::string digits_before(const std::string& text, std::size_t end) {
  std::size_t begin = end;
  while (begin > 0 && is_digit(text[begin - 1])) --begin;
  return text.substr(begin, end - begin);
}

Name name_of(const fs::path& path) {
  Name name;
  name.path = path.string();
  name.stem = path.stem().string();
  std::size_t end = name.stem.size();
  while (end > 0 && !is_digit(name.stem[end - 1])) --end;
  name.after = name.stem.substr(end);
  std::string digits = digits_before(name.stem, end);
  std::size_t begin = end - digits.size();
  if (begin > 1 && name.stem[begin - 1] == '.' && is_digit(name.stem[begin - 2])) {
    name.fraction = digits;
    digits = digits_before(name.stem, begin - 1);
    begin -= 1 + digits.size();
  }
  name.before = name.stem.substr(0, begin);
  name.whole = digits.substr(std::min(digits.find_first_not_of('0'), digits.size()));
  name.numbered = !digits.empty();
  return name;
}

bool number_below(const Name& a, const Name& b) {
  if (a.whole.size() != b.whole.size()) return a.whole.size() < b.whole.size();
  return std::tie(a.whole, a.fraction) < std::tie(b.whole, b.fraction);
}

/// Natural order: runs of digits compare as numbers, wherever they are in the name.
bool natural_below(const Name& a, const Name& b) {
  const std::string &s = a.stem, &t = b.stem;
  std::size_t i = 0, j = 0;
  while (i < s.size() && j < t.size()) {
    if (!is_digit(s[i]) || !is_digit(t[j])) {
      if (s[i] != t[j]) return s[i] < t[j];
      ++i, ++j;
      continue;
    }
    while (i < s.size() && s[i] == '0') ++i;
    while (j < t.size() && t[j] == '0') ++j;
    std::size_t m = i, n = j;
    while (m < s.size() && is_digit(s[m])) ++m;
    while (n < t.size() && is_digit(t[n])) ++n;
    if (m - i != n - j) return m - i < n - j;
    if (const int order = s.compare(i, m - i, t, j, n - j); order != 0) return order < 0;
    i = m, j = n;
  }
  if (s.size() - i != t.size() - j) return s.size() - i < t.size() - j;
  return s < t;
}

std::vector<Name> names_in(const fs::path& folder, std::uint64_t& hidden) {
  if (!fs::exists(folder)) throw SourceError(folder.string() + ": no such directory");
  if (!fs::is_directory(folder)) throw SourceError(folder.string() + ": is not a directory");
  std::vector<Name> names;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (!entry.is_regular_file() || entry.path().extension() != ".bin") continue;
    if (entry.path().filename().string().front() == '.') {
      ++hidden;
    } else {
      names.push_back(name_of(entry.path()));
    }
  }
  if (names.empty()) throw SourceError(folder.string() + ": holds no scans (*.bin)");
  return names;
}

bool all_numbered(const std::vector<Name>& names) {
  return std::all_of(names.begin(), names.end(), [&](const Name& n) {
    return n.numbered && n.before == names.front().before && n.after == names.front().after;
  });
}

void refuse_equal(const std::vector<Name>& names) {
  for (std::size_t i = 1; i < names.size(); ++i) {
    if (number_below(names[i - 1], names[i])) continue;
    throw SourceError(names[i].path + ": has the number of " + names[i - 1].path +
                      ": which comes first cannot be told");
  }
}

template <class Number>
Number middle(std::vector<Number> values) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// The names' numbers as integers; nothing if a number has a fraction or is too long.
std::optional<std::vector<std::uint64_t>> whole_numbers(const std::vector<Name>& names) {
  std::vector<std::uint64_t> numbers;
  for (const Name& name : names) {
    if (!name.fraction.empty() || name.whole.size() > kMostDigits + 1) return std::nullopt;
    numbers.push_back(name.whole.empty() ? 0 : std::stoull(name.whole));
  }
  return numbers;
}

/// Converts names to times in ns: seconds with a fraction, or integers in units of
/// 10^(digits_of_unit - 9) s.
std::optional<std::vector<std::int64_t>> times_in(const std::vector<Name>& names,
                                                  std::size_t digits_of_unit) {
  std::vector<std::int64_t> times_ns;
  for (const Name& name : names) {
    std::string fraction = name.fraction.substr(0, digits_of_unit);
    fraction.resize(digits_of_unit, '0');
    // One digit more, as there may be no other.
    const std::string digits = "0" + name.whole + fraction;
    std::int64_t time_ns = 0;
    const auto read = std::from_chars(digits.data(), digits.data() + digits.size(), time_ns);
    if (read.ec != std::errc{}) return std::nullopt;
    times_ns.push_back(time_ns);
  }
  return times_ns;
}

bool is_spaced(const std::vector<std::int64_t>& times_ns, double period_s, double most_periods) {
  std::vector<std::int64_t> steps_ns(times_ns.size());
  std::adjacent_difference(times_ns.begin(), times_ns.end(), steps_ns.begin());
  steps_ns.erase(steps_ns.begin());
  if (steps_ns.empty()) return true;
  const double periods = 1e-9 * static_cast<double>(middle(steps_ns)) / period_s;
  return periods >= kLeastPeriods && periods <= most_periods;
}

std::string runs_of(const std::vector<std::uint64_t>& numbers) {
  constexpr std::size_t kMostRuns = 5;
  std::string text;
  std::size_t runs = 0;
  for (std::size_t i = 0; i < numbers.size();) {
    std::size_t end = i + 1;
    while (end < numbers.size() && numbers[end] == numbers[end - 1] + 1) ++end;
    if (runs++ == kMostRuns) return text + " and others";
    text += (text.empty() ? "" : ", ") + std::to_string(numbers[i]);
    if (end > i + 1) text += " to " + std::to_string(numbers[end - 1]);
    i = end;
  }
  return text;
}

/// Lists every number from the first to the last; a number without a file gets an empty name.
void fill_in(const std::vector<std::uint64_t>& numbers, ScanList& list) {
  std::vector<std::string> files;
  std::vector<std::uint64_t> missing;
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    for (std::uint64_t n = i == 0 ? numbers[0] : numbers[i - 1] + 1; n < numbers[i]; ++n) {
      files.emplace_back();
      missing.push_back(n);
    }
    files.push_back(list.files[i]);
  }
  list.files = std::move(files);
  list.first_number = numbers.front();
  list.numbers.resize(list.files.size());
  std::iota(list.numbers.begin(), list.numbers.end(), std::uint64_t{0});
  if (missing.empty()) return;
  list.remarks.push_back("scans are missing, by their numbers, and stand as empty ones: " +
                         runs_of(missing));
}

/// Decides what the numbers in the names are: numbers of scans, of every n-th scan, or times.
void use_numbers(const std::vector<Name>& names, double period_s, ScanList& list) {
  const auto numbers = whole_numbers(names);
  if (numbers) {
    const std::uint64_t span = numbers->back() - numbers->front();
    std::uint64_t step = 0;
    for (const std::uint64_t n : *numbers) step = std::gcd(step, n - numbers->front());
    const std::uint64_t most = kMostPerScan * numbers->size() + kFewScans;
    if (step <= 1 && span < most) return fill_in(*numbers, list);
    if (step > 1 && span / step < most && span < kMostSpan) {
      list.first_number = numbers->front();
      for (const std::uint64_t n : *numbers) list.numbers.push_back(n - numbers->front());
      list.time_remark = "the scans' numbers go up by " + std::to_string(step) +
                         ": so many periods lie between them";
      return;
    }
  }
  for (const std::size_t digits : {9U, 6U, 3U, 0U}) {
    if (!numbers && digits != 9) break;
    const auto times_ns = times_in(names, digits);
    if (!times_ns || !is_spaced(*times_ns, period_s, kMostPeriods)) continue;
    list.times_ns = *times_ns;
    return;
  }
  list.time_remark =
      "the scans' names are neither numbers of scans nor times: each is taken for one period after "
      "the one before";
}

std::vector<std::int64_t> times_of_line(const std::string& line, std::size_t columns,
                                        const std::string& where) {
  const char* at = line.c_str();
  std::vector<std::int64_t> row_ns;
  for (char* end = nullptr;; at = end) {
    const double seconds = std::strtod(at, &end);
    if (end == at) break;
    const bool in_reach = std::isfinite(seconds) && std::abs(seconds) < kLatestS;
    if (!in_reach) throw SourceError(where + "\"" + line + "\": no time in seconds");
    row_ns.push_back(std::llround(seconds * 1e9));
  }
  const bool to_its_end = std::string_view(at).find_first_not_of(" \t\r") == std::string_view::npos;
  if (to_its_end && row_ns.size() == columns) return row_ns;
  throw SourceError(where + std::to_string(columns) + " times in seconds expected, not \"" + line +
                    "\"");
}

}  // namespace

ScanList list_scans(const std::string& folder, double period_s) {
  ScanList list;
  std::vector<Name> names = names_in(folder, list.hidden);
  const bool numbered = all_numbered(names);
  std::sort(names.begin(), names.end(), numbered ? number_below : natural_below);
  if (numbered) refuse_equal(names);
  for (const Name& name : names) list.files.push_back(name.path);
  if (numbered) use_numbers(names, period_s, list);
  return list;
}

std::vector<std::int64_t> read_times(const std::string& path, std::size_t columns,
                                     double period_s) {
  std::ifstream file(path);
  if (!file) throw SourceError(path + ": " + std::strerror(errno));
  std::vector<std::int64_t> times_ns, begins_ns;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    const std::string where = path + ":" + std::to_string(number) + ": ";
    if (number == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
    const std::size_t first = line.find_first_not_of(" \t\r");
    if (first == std::string::npos || line[first] == '#') continue;
    const std::vector<std::int64_t> row_ns = times_of_line(line, columns, where);
    if (!begins_ns.empty() && row_ns.front() <= begins_ns.back()) {
      throw SourceError(where + "the time is not after the one before");
    }
    begins_ns.push_back(row_ns.front());
    times_ns.insert(times_ns.end(), row_ns.begin(), row_ns.end());
  }
  if (begins_ns.size() > 1 && !is_spaced(begins_ns, period_s, kMostPeriodsOfTimes)) {
    throw SourceError(path + ": its times are no seconds, or of another sensor: scans of " +
                      std::to_string(period_s) + " s are expected (driver.scan_period_s)");
  }
  return times_ns;
}

}  // namespace zloam::driver
