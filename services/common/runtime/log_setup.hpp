#pragma once
// Called once per process, before the first line that matters.

#include <string>

namespace zloam::runtime {

/// level: debug, info, warning or error.
void setup_log(const std::string& stage, const std::string& level, bool json);

}  // namespace zloam::runtime
