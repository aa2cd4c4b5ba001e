#pragma once
// Matching against a map of counted planes in voxels (common/plane_map): the sweep's own motion is
// estimated again with its pose, from each point's own time, so that the odometry's residual
// distortion is removed before the points are matched and counted.

#include "mapping/method.hpp"

namespace zloam::mapping {

std::unique_ptr<MappingMethod> make_voxel_planes_method(const MappingConfig& config);

}  // namespace zloam::mapping
