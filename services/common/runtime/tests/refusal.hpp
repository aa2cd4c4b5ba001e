#pragma once
// Shared by the tests of the stages' parameters.

#include <optional>
#include <string>
#include <vector>

#include "common/runtime/parameters.hpp"

namespace zloam::runtime::test {

/// Why these settings are refused; empty: they are accepted.
inline std::string refusal_of(Parameters& parameters, const std::vector<std::string>& settings) {
  try {
    parameters.load(std::nullopt, settings);
  } catch (const ConfigError& e) {
    return e.what();
  }
  return {};
}

}  // namespace zloam::runtime::test
