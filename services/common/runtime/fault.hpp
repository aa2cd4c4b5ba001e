#pragma once
// Faults that tests order by the environment.

#include <cstdint>
#include <optional>
#include <string>

namespace zloam::runtime {

/// The whole number that the variable holds; none where it is unset or empty. Throws ConfigError.
std::optional<std::uint64_t> fault(const std::string& variable);

/// ZLOAM_FAULT_CLOCK_AHEAD_MS, in ns: this process stands for another host whose clock is ahead.
std::int64_t clock_fault_ns();

}  // namespace zloam::runtime
