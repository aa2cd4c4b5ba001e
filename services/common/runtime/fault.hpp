#pragma once
// Faults that tests order by the environment.

#include <cstdint>
#include <optional>
#include <string>

namespace zloam::runtime {

/// The whole number that the variable holds; none where it is unset or empty. Throws ConfigError.
std::optional<std::uint64_t> fault(const std::string& variable);

}  // namespace zloam::runtime
