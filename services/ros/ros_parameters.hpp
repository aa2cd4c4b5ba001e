#pragma once
// Names of the configuration for ROS's side.

#include "common/runtime/parameters.hpp"
#include "ros/config.hpp"

namespace zloam::ros {

void bind(runtime::Parameters& parameters, RosConfig& config);

}  // namespace zloam::ros
