#pragma once
// What stands in a submap, without what moved through it: a car, a person.
//
// A voxel that later or earlier sweeps see through was empty then. Which sweeps hit a voxel and from
// where is in the submap (common/geometry/submap.hpp); a sweep sees through a place where one of its
// rays passes close by and hits something well behind. What stands is hit more often than it is
// missed closely; what moves is hit once or twice, and seen through by all others.
// After the idea of visibility in Pomerleau et al., "Long-term 3D map maintenance in dynamic
// environments", ICRA 2014.

#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::sessions {

/// Of each point whether it moved; all false where the submap does not tell which sweeps hit it.
std::vector<bool> moving_points(const Submap& submap);

/// The submap without them.
Submap standing(const Submap& submap);

}  // namespace zloam::sessions
