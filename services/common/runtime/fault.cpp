#include "common/runtime/fault.hpp"

#include <cstdlib>
#include <string_view>

#include "common/runtime/parameters.hpp"
#include "common/runtime/whole_number.hpp"

namespace zloam::runtime {

std::optional<std::uint64_t> fault(const std::string& variable) {
  const char* text = std::getenv(variable.c_str());
  if (text == nullptr || *text == '\0') return std::nullopt;
  const std::string_view view(text);
  const auto number = whole_number<std::uint64_t>(view);
  if (!number) {
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
