#pragma once
// Names, ranges and meaning of what can be configured about odometry.

#include "odometry/config.hpp"

namespace zloam::runtime {
class Parameters;
}

namespace zloam::odometry {

void bind(runtime::Parameters& parameters, OdometryConfig& config);

}  // namespace zloam::odometry
