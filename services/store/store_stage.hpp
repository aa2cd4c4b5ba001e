#pragma once
// Wires the tile store to the runtime: takes map/tile/**, the newest map/odometry and each
// map/submap, answers gets for all of them.

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/runtime/async_get.hpp"
#include "common/runtime/shared.hpp"
#include "common/runtime/stage.hpp"
#include "common/zenoh/zenoh.hpp"
#include "store/config.hpp"
#include "store/generation.hpp"
#include "store/live_publisher.hpp"
#include "store/tile_store.hpp"

namespace zloam::store {

class StoreStage {
 public:
  StoreStage(runtime::Stage& stage, const StoreConfig& config);

 private:
  using TileMessage = runtime::Received<msg::MapTile>;
  using PoseMessage = runtime::Received<msg::MapPose>;
  using SubmapMessage = runtime::Received<msg::Submap>;

  struct Held {
    runtime::Inlet* inlet;
    runtime::Message message;
    std::int64_t since_ns;
  };
  runtime::Outcome take_or_hold(const TileMessage& tile);
  runtime::Outcome take_or_hold(const PoseMessage& pose);
  runtime::Outcome take_or_hold(const SubmapMessage& submap);
  void take(const TileMessage& tile);
  void take(const msg::MapTile& tile, std::span<const std::uint8_t> bytes);
  bool only_looks(const msg::Header& header) const;
  void take(const PoseMessage& pose);
  void put_pose(const PoseMessage& pose);
  bool is_of_early_pose(const msg::Header& header) const;
  void put_early_pose();
  void take(const SubmapMessage& submap);
  /// Holds the message until its publisher was asked.
  runtime::Outcome hold(runtime::Inlet* inlet, const runtime::Message& message);
  Held take_oldest();
  void refuse_oldest();
  bool is_believed(const Held& held) const;
  void ask_publisher();
  void hear_publisher();
  void settle_held();
  void put(const std::string& key, Key kind, const Rank& rank, std::span<const std::uint8_t> bytes);
  void answer(runtime::Answer& answer);
  /// Requests all tiles from mapping, as puts may be dropped; takes the newer ones.
  void fetch();
  void take_fetched();
  void finish_fetch();
  void every_period();
  void sync();
  std::string lacks() const;
  void say_disk();
  std::optional<std::uint64_t> generation_of(const msg::Header& header, const std::string& key);
  void begin(const msg::Header& header);
  void begin_again(const msg::Header& header);
  /// Keeps a live run's map in a folder of its own before another map replaces it.
  void keep_earlier();
  void remove_oldest();
  bool has_live_map();
  void not_stored(const std::string& key, const std::string& why);
  void say_recovery() const;
  void say_damage() const;
  void say_stranger() const;

  /// Results of a get's callbacks; outlives the stage when an answer is late.
  struct Fetched {
    struct Answer {
      std::string encoding;
      zenoh::AlignedBytes bytes;
    };
    std::mutex mutex;
    std::condition_variable ended;
    bool is_running = false;
    // Copied out of shared memory at once, before it is written again.
    std::vector<Answer> answers;
    /// answers that were overwritten before they were copied, that can't be read, and errors
    std::size_t lost = 0;
  };

  runtime::Stage& stage_;
  StoreConfig config_;
  TileStore store_;
  Generations generations_;
  int fetches_left_ = 0;
  /// What the last fetch lacked; empty: nothing.
  std::string not_fetched_;
  std::shared_ptr<Fetched> fetched_ = std::make_shared<Fetched>();
  std::uint64_t old_ = 0;
  /// keys of messages that could not be written, and why the last one could not
  std::set<std::string> unstored_;
  std::string disk_error_;
  /// why the map before this one is not kept
  std::string keep_error_;
  /// a live run has a part in the current map; nothing: not looked yet
  std::optional<bool> has_live_;

  runtime::Inlet* tiles_ = nullptr;
  runtime::Inlet* poses_ = nullptr;
  runtime::Inlet* submaps_ = nullptr;
  LivePublisher publisher_;
  /// the newest pose of a map of which neither a tile nor a submap has come yet
  std::optional<PoseMessage> early_pose_;
  Extensions extensions_;
  /// the publisher has just changed
  bool is_new_ = true;
  std::deque<Held> held_;
  std::size_t held_bytes_ = 0;
  runtime::AsyncGet question_;
  std::shared_ptr<runtime::Shared> question_bell_ = std::make_shared<runtime::Shared>();
  std::uint64_t unconfirmed_ = 0;
};

}  // namespace zloam::store
