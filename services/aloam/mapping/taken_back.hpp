#pragma once
// The cubes of the instance before this one. The store and that instance, which may still run, both
// send them, in any order: of each cube and layer the newest stays.

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>

#include "aloam/core/cube_map.hpp"
#include "common/geometry/map_layer.hpp"

namespace zloam::aloam {

class TakenBack {
 public:
  /// Term and version: more is newer.
  using Rank = std::pair<std::uint32_t, std::uint64_t>;

  void add(const CubeIndex& index, Layer layer, const Rank& rank, const Cloud::Ptr& points) {
    const auto [kept, is_new] = ranks_.try_emplace({index, layer}, rank);
    if (!is_new && rank <= kept->second) return;
    kept->second = rank;
    Cube& cube = cubes_[index];
    (layer == Layer::kEdge ? cube.edges : cube.planes) = points;
    cube.version = std::max(cube.version, rank.second);
  }
  std::map<CubeIndex, Cube> take() { return std::exchange(cubes_, {}); }

 private:
  std::map<std::pair<CubeIndex, Layer>, Rank> ranks_;
  std::map<CubeIndex, Cube> cubes_;
};

}  // namespace zloam::aloam
