#pragma once
// Faults that tests set in the environment.

#include <cstdint>
#include <optional>
#include <string>

namespace zloam::runtime {

/// The whole number in the variable; nothing when it is unset or empty. Throws ConfigError.
std::optional<std::uint64_t> fault(const std::string& variable);

/// ZLOAM_FAULT_CLOCK_AHEAD_MS, in ns: simulates another host whose clock is ahead.
std::int64_t clock_fault_ns();

}  // namespace zloam::runtime
