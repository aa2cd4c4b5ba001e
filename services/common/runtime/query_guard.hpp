#pragma once
// Check before a query's payload is copied or read.

#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Refuses a command whose payload is larger than any command's; true: it was refused.
bool refused_for_size(zenoh::Query& query);

}  // namespace zloam::runtime
