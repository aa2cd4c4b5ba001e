#pragma once
// Searches the map for a sweep that is only known to be near some pose: correlative matching
// (Olson, Real-time correlative scan matching, ICRA 2009). Counts the sweep's points in occupied
// cells of the map at every place and heading of a grid; the height is near the guess's, roll and
// pitch are the guess's. The cost is bounded and does not depend on the map's size.

#include <cstddef>
#include <vector>

#include "mapping/mapping.hpp"

namespace zloam::mapping {

class TileMap;

/// Around the guess, to each side.
struct SearchArea {
  double distance_m = 0.0;
  double rotation_rad = 0.0;
};

/// Poses of base_link at which most of the sweep's points meet points of the map, best first, at
/// most `most`, none adjacent to another. Empty where sweep or map have no points.
std::vector<Pose> likely_places(const TileMap& tiles, const MappingInput& input, const Pose& guess,
                                const SearchArea& area, std::size_t most);

}  // namespace zloam::mapping
