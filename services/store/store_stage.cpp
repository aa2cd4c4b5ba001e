#include "store/store_stage.hpp"

#include <algorithm>
#include <chrono>

#include "common/zenoh/aligned.hpp"
#include "store/key_expression.hpp"

namespace zloam::store {
namespace {

constexpr std::uint64_t kMiB = 1U << 20;
constexpr std::chrono::seconds kFetchTimeout{20};
// A whole map at the end of a run, while the disk is slow.
constexpr std::size_t kHeldMessages = 4096;

TileStore open_store(const StoreConfig& config) {
  try {
    return TileStore(config.path, StoreLimits{});
  } catch (const std::exception& e) {
    throw runtime::IoError(std::string("store.path: ") + e.what());
  }
}

/// A finished message as the runtime takes it. Without an allocator the buffer is freed by
/// delete[].
Buffer buffer_of(const std::vector<std::uint8_t>& bytes) {
  auto* data = new std::uint8_t[bytes.size()];
  std::copy(bytes.begin(), bytes.end(), data);
  return Buffer(nullptr, false, data, bytes.size(), data, bytes.size());
}

double mib(std::uint64_t bytes) { return static_cast<double>(bytes) / static_cast<double>(kMiB); }

}  // namespace

StoreStage::StoreStage(runtime::Stage& stage, const StoreConfig& config)
    : stage_(stage), config_(config), store_(open_store(config)), generations_(store_) {
  say_recovery();
  runtime::InletOptions tiles;
  tiles.order = runtime::Order::kAsTheyCome;
  tiles.ends_run = false;
  tiles.newest = kHeldMessages;
  stage.inlet_at<msg::MapTile>(Key::kMapTile, stage.keys().all_tiles(), tiles,
                               [this](const TileMessage& tile) { take(*tile, tile.raw().bytes); });
  runtime::InletOptions poses;
  poses.order = runtime::Order::kAsTheyCome;
  poses.newest = kHeldMessages;
  stage.inlet<msg::MapPose>(Key::kMapOdometry, poses,
                            [this](const PoseMessage& pose) { take(pose); });
  const auto reply = [this](runtime::Answer& a) { answer(a); };
  stage.answer(stage.keys().all_tiles(), reply);
  stage.answer(stage.keys().of(Key::kMapOdometry), reply);
  stage.on_end_of_run([this](std::uint64_t) { fetch(); });
  stage.every(std::chrono::milliseconds(config_.sync_ms), [this] { every_period(); });
  stage.on_stop([this] { store_.sync(); });
}

void StoreStage::say_recovery() const {
  const Recovery& r = store_.recovery();
  runtime::log_info("tiles on disk", {{"keys", store_.keys().size()},
                                      {"records", r.records},
                                      {"mib", mib(r.bytes)},
                                      {"path", config_.path}});
  if (r.cut_bytes > 0 || r.ignored_segments > 0) {
    runtime::log_warning("the log ended in a broken record, which was cut off",
                         {{"bytes", r.cut_bytes}, {"segments_set_aside", r.ignored_segments}});
  }
}

void StoreStage::take(const msg::MapTile& tile, std::span<const std::uint8_t> bytes) {
  const msg::Header& header = *tile.header();
  const Rank rank{generations_.of(header.run(), header.map_id()), header.term(), tile.version()};
  put(stage_.keys().tile(tile.layer()->str(), tile.i(), tile.j(), tile.k()), Key::kMapTile, rank,
      bytes);
}

void StoreStage::take(const PoseMessage& pose) {
  const msg::Header& header = pose.header();
  // Sweep numbers start again with each run of a map, the sensor's time does not.
  const auto version = static_cast<std::uint64_t>(std::max<std::int64_t>(pose->instant_ns(), 0));
  // The capture is replayed again: what is left of the last time would be the newer one, and a
  // mapping that is killed would go on where that run ended.
  const auto known = store_.rank(stage_.keys().of(Key::kMapOdometry));
  const bool again = header.replay() && pose.sweep() == 0 && known && known->version > version;
  if (again && generations_.is_current(header.run(), header.map_id())) {
    generations_.begin(header.run(), header.map_id());
  }
  const Rank rank{generations_.of(header.run(), header.map_id()), header.term(), version};
  put(stage_.keys().of(Key::kMapOdometry), Key::kMapOdometry, rank, pose.raw().bytes);
}

void StoreStage::put(const std::string& key, Key kind, const Rank& rank,
                     std::span<const std::uint8_t> bytes) {
  try {
    const StoredMessage message{key, encoding_of(kind), rank, {bytes.begin(), bytes.end()}};
    if (store_.put(message) == PutResult::kOld) ++old_;
    if (store_.unsynced_bytes() >= static_cast<std::uint64_t>(config_.sync_mib) * kMiB) {
      store_.sync();
    }
    stage_.degraded("disk", "");
  } catch (const std::system_error& e) {
    stage_.degraded("disk", e.what());
  }
}

void StoreStage::answer(runtime::Answer& answer) {
  // By number only the publisher answers.
  if (!answer.parameters().empty()) return;
  for (const std::string& key : store_.keys()) {
    if (!covers(answer.key(), key)) continue;
    const auto message = store_.get(key);
    if (!message) continue;
    answer.reply(key, message->encoding, buffer_of(message->payload));
  }
}

void StoreStage::fetch() {
  zenoh::GetOptions options;
  options.timeout = kFetchTimeout;
  stage_.session().get(
      stage_.keys().all_tiles(),
      [fetched = fetched_](zenoh::Reply&& reply) {
        if (!reply.ok()) return;
        const std::lock_guard lock(fetched->mutex);
        fetched->samples.push_back(std::move(*reply.sample));
      },
      [] {}, options);
}

void StoreStage::take_fetched() {
  std::vector<zenoh::Sample> samples;
  {
    const std::lock_guard lock(fetched_->mutex);
    samples.swap(fetched_->samples);
  }
  for (zenoh::Sample& sample : samples) {
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(std::move(sample.payload));
    if (!verify<msg::MapTile>(bytes.data(), sample.encoding).ok()) continue;
    const auto& tile = message_of<msg::MapTile>(bytes.data());
    // An answer of a map that is gone must not bring it back.
    const msg::Header& header = *tile.header();
    if (generations_.is_current(header.run(), header.map_id())) take(tile, bytes.data());
  }
}

void StoreStage::every_period() {
  take_fetched();
  try {
    store_.sync();
    if (store_.compact_if_due()) runtime::log_info("compacted", {{"mib", mib(store_.log_bytes())}});
  } catch (const std::system_error& e) {
    stage_.degraded("disk", e.what());
  }
  stage_.figure("keys", static_cast<double>(store_.keys().size()));
  stage_.figure("log_mib", mib(store_.log_bytes()));
  stage_.figure("live_mib", mib(store_.live_bytes()));
  stage_.figure("unsynced_bytes", static_cast<double>(store_.unsynced_bytes()));
  stage_.figure("old_messages", static_cast<double>(old_));
}

}  // namespace zloam::store
