#pragma once
// The tiles of the map that /map shows: of each the newest state.

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/geometry/map_layer.hpp"

namespace zloam::ros {

class ShownTiles {
 public:
  /// term and version: more is newer
  using Rank = std::pair<std::uint64_t, std::uint64_t>;
  /// Received messages determine the number of tiles; this limit, above what any robot has, bounds
  /// the memory that an unknown sender can occupy.
  static constexpr std::size_t kMost = 65'536;

  /// kNone: no newer state of a tile with points. The voxels' layer, of many more and smaller
  /// cubes, has none.
  enum class Taken : std::uint8_t { kTaken, kNone, kFull };
  Taken take(std::string_view layer, const std::string& key, const Rank& rank,
             std::span<const MapPoint> points) {
    if (!layer_from_name(layer)) return Taken::kNone;
    const auto found = tiles_.find(key);
    if (found == tiles_.end() && tiles_.size() >= kMost) return Taken::kFull;
    if (found != tiles_.end() && rank <= found->second.rank) return Taken::kNone;
    tiles_[key] = {rank, {points.begin(), points.end()}};
    return Taken::kTaken;
  }
  void clear() { tiles_.clear(); }
  bool empty() const { return tiles_.empty(); }
  std::vector<MapPoint> points() const {
    std::vector<MapPoint> all;
    for (const auto& [key, tile] : tiles_) {
      all.insert(all.end(), tile.points.begin(), tile.points.end());
    }
    return all;
  }

 private:
  struct Tile {
    Rank rank;
    std::vector<MapPoint> points;
  };
  std::map<std::string, Tile> tiles_;
};

}  // namespace zloam::ros
