#pragma once
// The map after one that is lost: a mapping was killed, and no process keeps its tiles. As after a
// reset the new map has a map_id of its own. Under the old one, readers that keep tiles by map_id
// would show those of the lost map as parts of the new one.

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>

namespace zloam::runtime {

/// Whether an instance of mapping before this one may have mapped sweeps of the run. A replay waits
/// for its stages; in a live run a stage that starts with the others hears one of the first sweeps,
/// of which there are as many as stages keep.
inline bool may_follow_another(bool replay, std::uint64_t first_sweep, int kept_sweeps) {
  const auto kept = static_cast<std::uint64_t>(std::max(0, kept_sweeps));
  return replay ? first_sweep > 0 : first_sweep > kept;
}

/// The maps that earlier instances had, as far as other processes name them.
class EarlierIds {
 public:
  void add(std::uint64_t map_id) { newest_ = std::max(newest_.value_or(map_id), map_id); }
  std::optional<std::uint64_t> newest() const { return newest_; }
  /// map_id of the next map. If no process names any, the run may still have had some: the first
  /// one with its own number, the others with one more for each reset, of which there are fewer
  /// than sweeps.
  std::uint64_t next(std::uint64_t run, std::uint64_t first_sweep) const {
    return newest_ ? *newest_ + 1 : run + first_sweep;
  }

 private:
  std::optional<std::uint64_t> newest_;
};

/// Reasons for the status. `why` the earlier map can't be used: a sentence; empty: no store has it.
inline std::string lost_map_text(std::uint64_t first_sweep, const std::string& why = {}) {
  return "the map before sweep " + std::to_string(first_sweep) +
         " is lost: " + (why.empty() ? "no store has it" : why) + "; a new one begins in its frame";
}
/// With no process that names an earlier map, mapping may only have started after the driver.
inline std::string lost_frame_text(std::uint64_t first_sweep, const std::string& why = {}) {
  return (why.empty() ? "any map before sweep " : "the map before sweep ") +
         std::to_string(first_sweep) + " and its frame are lost: " +
         (why.empty() ? "neither a store nor integration has them" : why) +
         "; a new one begins in the odometry's frame";
}

}  // namespace zloam::runtime
