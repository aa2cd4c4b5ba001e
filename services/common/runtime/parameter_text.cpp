#include "common/runtime/parameter_text.hpp"

#include <charconv>
#include <cmath>

namespace zloam::runtime {
namespace {

std::string number_text(double value) {
  char buffer[32];
  const auto end = std::to_chars(buffer, buffer + sizeof buffer, value);
  return {buffer, end.ptr};
}

/// Parses the whole text as a decimal number; YAML's 1_000 and hexadecimal numbers are refused.
template <class Number>
bool parse_number(const std::string& text, Number* value) {
  const char* begin = text.data() + (text.starts_with('+') ? 1 : 0);
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(begin, end, *value);
  return error == std::errc{} && stop == end && begin != end;
}

}  // namespace

std::string range_text(Range range) {
  const bool low = std::isfinite(range.min);
  const bool high = std::isfinite(range.max);
  if (low && high) return number_text(range.min) + " to " + number_text(range.max);
  if (low) return number_text(range.min) + " or more";
  if (high) return number_text(range.max) + " or less";
  return "any finite number";
}

std::string set_double(const std::string& text, Range range, double* value) {
  double parsed = 0.0;
  if (!parse_number(text, &parsed) || !std::isfinite(parsed)) return "a number is expected";
  if (parsed < range.min || parsed > range.max) return "out of range";
  *value = parsed;
  return {};
}

std::string set_integer(const std::string& text, Range range, std::int64_t* value) {
  std::int64_t parsed = 0;
  if (!parse_number(text, &parsed)) return "a whole number is expected";
  const auto wide = static_cast<double>(parsed);
  if (wide < range.min || wide > range.max) return "out of range";
  *value = parsed;
  return {};
}

std::string join(const std::vector<std::string>& items) {
  std::string text;
  for (const std::string& item : items) text += (text.empty() ? "" : ", ") + item;
  return text;
}

std::string shown(const RawValue& value) {
  switch (value.shape) {
    case RawValue::Shape::kScalar:
      return "'" + value.items.front() + "'";
    case RawValue::Shape::kList:
      return "[" + join(value.items) + "]";
    case RawValue::Shape::kMap:
      return "a section";
    case RawValue::Shape::kNull:
      return "nothing";
  }
  return "?";
}

}  // namespace zloam::runtime
