#pragma once
// Static points of a submap, without those of moving objects: a car, a person.
//
// A voxel that later or earlier sweeps see through was empty then. The submap contains which sweeps
// hit a voxel and from where (common/geometry/submap.hpp); a sweep sees through a place if one of
// its rays passes close by and hits something well behind. Static voxels are hit more often than
// closely missed; those of moving objects are hit once or twice, and seen through by all others.
// After the idea of visibility in Pomerleau et al., "Long-term 3D map maintenance in dynamic
// environments", ICRA 2014.

#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::sessions {

/// For each point whether it moved; all false if the submap does not contain which sweeps hit it.
std::vector<bool> moving_points(const Submap& submap);

/// The submap without these points; moving: for each of them.
Submap without(const Submap& submap, const std::vector<bool>& moving);

/// The submap without the moving points.
Submap standing(const Submap& submap);

}  // namespace zloam::sessions
