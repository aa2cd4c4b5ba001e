#pragma once
// Which map a message belongs to, as a number that only grows. A map is named by its map_id, which
// outlives the run that made it; without one (0) by the run. Runs of replays are hashes and have
// no order, so the order is that in which the store first met them.

#include <cstdint>

#include "store/tile_store.hpp"

namespace zloam::store {

class Generations {
 public:
  /// Goes on with what the store holds.
  explicit Generations(TileStore& store);
  /// The number of that map; a new one is written to the store at once, which puts the old map
  /// away.
  std::uint64_t of(std::uint64_t run, std::uint64_t map_id);
  /// Another map than the one before, though it may bear the same name: a capture that is replayed
  /// again has the same run.
  std::uint64_t begin(std::uint64_t run, std::uint64_t map_id);
  std::uint64_t current() const { return number_; }
  bool is_current(std::uint64_t run, std::uint64_t map_id) const;

 private:
  TileStore& store_;
  std::uint64_t number_ = 0;
  std::uint64_t run_ = 0;
  std::uint64_t map_id_ = 0;
};

}  // namespace zloam::store
