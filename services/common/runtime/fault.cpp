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

}  // namespace zloam::runtime
