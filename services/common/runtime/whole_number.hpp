#pragma once
// Parses a text that is a whole number and nothing else: in keys, selectors and variables.

#include <charconv>
#include <optional>
#include <string_view>

namespace zloam::runtime {

template <class Number>
std::optional<Number> whole_number(std::string_view text) {
  Number number{};
  const char* end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, number);
  if (error != std::errc{} || rest != end) return std::nullopt;
  return number;
}

}  // namespace zloam::runtime
