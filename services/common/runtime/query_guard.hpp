#pragma once
// Refusals before a query's payload is copied or read.

#include <string_view>

#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Refuses a command whose payload is larger than any command's; true: it was refused.
bool refused_for_size(zenoh::Query& query);

inline constexpr const char* kBusy = "too many questions wait already: ask again later";

/// Answers a command for which there is no place among those that wait for the worker.
void refuse_as_busy(zenoh::Query& query, std::string_view key);

}  // namespace zloam::runtime
