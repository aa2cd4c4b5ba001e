#pragma once
// Wires the tile store to the runtime: takes map/tile/** and the newest map/odometry, answers gets
// for both.

#include <memory>
#include <mutex>
#include <vector>

#include "common/runtime/stage.hpp"
#include "common/zenoh/zenoh.hpp"
#include "store/config.hpp"
#include "store/generation.hpp"
#include "store/tile_store.hpp"

namespace zloam::store {

class StoreStage {
 public:
  StoreStage(runtime::Stage& stage, const StoreConfig& config);

 private:
  using TileMessage = runtime::Received<msg::MapTile>;
  using PoseMessage = runtime::Received<msg::MapPose>;

  void take(const msg::MapTile& tile, std::span<const std::uint8_t> bytes);
  void take(const PoseMessage& pose);
  void put(const std::string& key, Key kind, const Rank& rank, std::span<const std::uint8_t> bytes);
  void answer(runtime::Answer& answer);
  /// Asks mapping for all its tiles, as puts may be dropped; what is newer is taken.
  void fetch();
  void take_fetched();
  void every_period();
  void say_recovery() const;

  /// What the callbacks of a get hand over; outlives the stage when an answer is late.
  struct Fetched {
    std::mutex mutex;
    std::vector<zenoh::Sample> samples;
  };

  runtime::Stage& stage_;
  StoreConfig config_;
  TileStore store_;
  Generations generations_;
  std::shared_ptr<Fetched> fetched_ = std::make_shared<Fetched>();
  std::uint64_t old_ = 0;
};

}  // namespace zloam::store
