#pragma once
// Reduces a sweep to one point, the mean, in each voxel.

#include <Eigen/Core>
#include <vector>

#include "common/geometry/point.hpp"

namespace zloam::mapping {

/// Means in the order in which their voxels were first hit; points that are not finite are left
/// out. leaf_m <= 0: all points. Same frame as the input.
std::vector<Eigen::Vector3d> voxel_means(PointSpan points, double leaf_m);

}  // namespace zloam::mapping
