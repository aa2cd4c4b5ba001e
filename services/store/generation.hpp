#pragma once
// The map that a message belongs to, as a number that only grows. A map is named by its map_id,
// which outlives the run that made it; without one (0) by the run. Runs of replays are hashes and
// have no order, so maps are numbered in the order in which the store first received them.

#include <cstdint>
#include <optional>

#include "store/tile_store.hpp"

namespace zloam::store {

class Generations {
 public:
  /// Continues from the content of the store.
  explicit Generations(TileStore& store);
  /// Starts another map than the one before, even with the same name: a capture that is replayed
  /// again has the same run. Its number is written to the store at once, which makes the old map
  /// obsolete.
  void begin(std::uint64_t run, std::uint64_t map_id);
  std::uint64_t current() const { return number_; }
  bool is_current(std::uint64_t run, std::uint64_t map_id) const;

 private:
  TileStore& store_;
  std::uint64_t number_ = 0;
  std::uint64_t run_ = 0;
  std::uint64_t map_id_ = 0;
};

/// Which runs add to the map of another one, by their tiles; others only look at it.
class Extensions {
 public:
  void tile_came(std::uint64_t run, std::uint64_t map_id) {
    if (map_id != run) run_ = run;
  }
  bool only_looks(std::uint64_t run, std::uint64_t map_id) const {
    return map_id != 0 && map_id != run && run_ != run;
  }

 private:
  /// the last one that added
  std::optional<std::uint64_t> run_;
};

}  // namespace zloam::store
