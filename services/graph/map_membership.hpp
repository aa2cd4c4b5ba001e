#pragma once
// Which map a message is of, as seen from the map that the graph is of. Poses and submaps wait in
// queues of their own: while the graph is behind, a submap may be handled before poses that were
// published earlier, also before the last ones of the map before.

#include <cstdint>
#include <optional>

namespace zloam::graph {

enum class Membership : std::uint8_t {
  kCurrent,
  /// mapping has begun this map
  kBegins,
  /// of a map that begins when its first pose comes
  kEarly,
  /// a late one of a map before
  kPast
};

struct CurrentMap {
  std::uint64_t id = 0;
  /// nothing: no pose has come yet
  std::optional<std::int64_t> newest_pose_ns;
  /// it had begun before the graph was started: it has submaps, or is to get those of before
  bool starts_late = false;

  bool is_past(std::int64_t instant_ns) const {
    return newest_pose_ns && instant_ns <= *newest_pose_ns;
  }
};

/// Poses are handled in the order of their instants, so the first one of another map ends this map.
inline Membership membership_of_pose(const CurrentMap& map, std::uint64_t map_id,
                                     std::int64_t instant_ns) {
  if (map_id == map.id) return Membership::kCurrent;
  return map.is_past(instant_ns) ? Membership::kPast : Membership::kBegins;
}

/// A submap ends no map: poses of this map may still be queued. Nor does one begin a map, also not
/// that of a run whose first message it is: the run's first poses may be of a map before it.
inline Membership membership_of_submap(const CurrentMap& map, std::uint64_t map_id,
                                       std::int64_t instant_ns) {
  const bool has_begun = map.newest_pose_ns || map.starts_late;
  if (map_id == map.id && has_begun) return Membership::kCurrent;
  return map.is_past(instant_ns) ? Membership::kPast : Membership::kEarly;
}

}  // namespace zloam::graph
