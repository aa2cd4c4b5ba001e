#pragma once
// Binds the configuration keys ros.* to RosConfig.

#include "common/runtime/parameters.hpp"
#include "ros/config.hpp"

namespace zloam::ros {

void bind(runtime::Parameters& parameters, RosConfig& config);

}  // namespace zloam::ros
