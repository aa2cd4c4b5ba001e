#pragma once
// Which submap saw a place of a map first, and whether something stood there.
//
// Mapping's cubes and voxels do not tell what moved; the submaps do (standing.hpp). What no submap
// has seen near a place is not known to stand there.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

#include "common/geometry/submap.hpp"

namespace zloam::sessions {

class SeenPlaces {
 public:
  /// moving: for each point of the submap. Submaps in order; number: of this one.
  void add(const Submap& submap, const std::vector<bool>& moving, std::size_t number);

  /// The first submap that saw what stands there, by the nearest points; nothing: it moved, or no
  /// submap has seen anything within about a metre. Frame map.
  std::optional<std::size_t> standing_at(const Eigen::Vector3d& at_map) const;

 private:
  struct Votes {
    std::uint32_t standing = 0, moving = 0;
    std::size_t first = 0;
  };

  std::unordered_map<std::uint64_t, Votes> cells_;
};

}  // namespace zloam::sessions
