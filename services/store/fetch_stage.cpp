// Fetches mapping's tiles at the end of a run.
#include <algorithm>
#include <chrono>
#include <stdexcept>
#include <utility>

#include "common/zenoh/aligned.hpp"
#include "store/store_stage.hpp"

namespace zloam::store {
namespace {

constexpr std::chrono::seconds kFetchTimeout{20};
// Less than a process has from the signal on (9 s), with time left to write what came.
constexpr std::chrono::seconds kStopPatience{6};
// Answers wait in memory for no longer than that.
constexpr std::chrono::milliseconds kStopLook{200};

}  // namespace

// Requests all tiles from mapping, because tiles may have been dropped when they were published.
void StoreStage::fetch() {
  --fetches_left_;
  {
    const std::lock_guard lock(fetched_->mutex);
    fetched_->is_running = true;
  }
  zenoh::GetOptions options;
  options.timeout = kFetchTimeout;
  stage_.session().get(
      stage_.keys().all_tiles(),
      [fetched = fetched_](zenoh::Reply&& reply) {
        if (!reply.ok()) {
          const std::lock_guard lock(fetched->mutex);
          ++fetched->lost;
          return;
        }
        zenoh::AlignedBytes bytes = zenoh::view_aligned(std::move(reply.sample->payload));
        const std::lock_guard lock(fetched->mutex);
        if (bytes.torn()) {
          ++fetched->lost;
        } else {
          fetched->answers.push_back({reply.sample->encoding, std::move(bytes)});
        }
      },
      [fetched = fetched_] {
        const std::lock_guard lock(fetched->mutex);
        fetched->is_running = false;
        fetched->ended.notify_all();
      },
      options);
}

void StoreStage::take_fetched() {
  std::vector<Fetched::Answer> answers;
  bool ended = false;
  {
    const std::lock_guard lock(fetched_->mutex);
    answers.swap(fetched_->answers);
    ended = !fetched_->is_running;
  }
  for (const Fetched::Answer& answer : answers) {
    const auto bytes = answer.bytes.data();
    if (!verify<msg::MapTile>(bytes, answer.encoding).ok()) {
      const std::lock_guard lock(fetched_->mutex);
      ++fetched_->lost;
      continue;
    }
    const auto& tile = message_of<msg::MapTile>(bytes);
    // A late answer of an obsolete map must not make that map current again.
    const msg::Header& header = *tile.header();
    if (generations_.is_current(header.run(), header.map_id()) || is_of_early_pose(header)) {
      take(tile, bytes);
    }
  }
  if (!ended) return;
  const std::size_t lost = std::exchange(fetched_->lost, 0);
  if (lost == 0) return;
  if (fetches_left_ > 0) {
    fetch();
  } else {
    not_fetched_ =
        std::to_string(lost) +
        " answers with tiles of the map were lost on their way from mapping: the map in " +
        config_.path + " may lack them";
    stage_.degraded("map", not_fetched_);
  }
}

// The stage is stopping: waits for a fetch that is still running, and stores its answers. A mapping
// that stops too, or hangs, may never answer, and whoever stops this process does not wait long.
void StoreStage::finish_fetch() {
  const auto until = std::chrono::steady_clock::now() + kStopPatience;
  fetches_left_ = 0;
  bool ended = false;
  while (!ended && std::chrono::steady_clock::now() < until) {
    {
      std::unique_lock lock(fetched_->mutex);
      ended = fetched_->ended.wait_until(
          lock, std::min(until, std::chrono::steady_clock::now() + kStopLook),
          [this] { return !fetched_->is_running; });
    }
    take_fetched();
  }
  if (!ended) {
    throw std::runtime_error(
        "mapping did not send its map in time: tiles of it may be missing in " + config_.path);
  }
  if (!not_fetched_.empty()) throw runtime::IoError(not_fetched_);
}

}  // namespace zloam::store
