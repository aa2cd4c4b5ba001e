#include "common/runtime/fault.hpp"

#include <charconv>
#include <cstdlib>
#include <string_view>

#include "common/runtime/parameters.hpp"

namespace zloam::runtime {

std::optional<std::uint64_t> fault(const std::string& variable) {
  const char* text = std::getenv(variable.c_str());
  if (text == nullptr || *text == '\0') return std::nullopt;
  const std::string_view view(text);
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(view.data(), view.data() + view.size(), number);
  if (error != std::errc{} || end != view.data() + view.size()) {
    throw ConfigError(variable + ": value '" + std::string(view) +
                      "' is refused: a whole number is expected");
  }
  return number;
}

std::int64_t clock_fault_ns() {
  constexpr std::int64_t kNsPerMs = 1'000'000;
  static const auto ahead_ns = static_cast<std::int64_t>(
      fault("ZLOAM_FAULT_CLOCK_AHEAD_MS").value_or(0) * static_cast<std::uint64_t>(kNsPerMs));
  return ahead_ns;
}

}  // namespace zloam::runtime
