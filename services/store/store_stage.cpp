#include "store/store_stage.hpp"

#include <algorithm>
#include <chrono>
#include <stdexcept>
#include <utility>

#include "common/messages/key_match.hpp"

namespace zloam::store {
namespace {

constexpr std::uint64_t kMiB = 1U << 20;
constexpr std::chrono::milliseconds kStopDrain{1500};
// Attempts to fetch the map: under load, answers may be overwritten in shared memory before they
// are copied.
constexpr int kFetches = 3;
// Input queue: holds a whole map that arrives at the end of a run while the disk is slow.
constexpr std::size_t kHeldMessages = 4096;
constexpr std::chrono::milliseconds kAskEvery{100};

TileStore open_store(const StoreConfig& config) {
  try {
    return TileStore(config.path, StoreLimits{});
  } catch (const std::exception& e) {
    throw runtime::IoError(std::string("store.path: ") + e.what());
  }
}

/// Copies a message into the runtime's buffer type. A Buffer without an allocator frees its memory
/// by delete[].
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
  tiles_ =
      &stage.inlet_at<msg::MapTile>(Key::kMapTile, stage.keys().all_tiles(), tiles,
                                    [this](const TileMessage& tile) { return take_or_hold(tile); });
  runtime::InletOptions poses;
  poses.order = runtime::Order::kAsTheyCome;
  poses.newest = kHeldMessages;
  poses_ = &stage.inlet<msg::MapPose>(
      Key::kMapOdometry, poses, [this](const PoseMessage& pose) { return take_or_hold(pose); });
  runtime::InletOptions submaps = poses;
  submaps.ends_run = false;
  submaps_ = &stage.inlet<msg::Submap>(
      Key::kSubmap, submaps, [this](const SubmapMessage& submap) { return take_or_hold(submap); });
  const auto reply = [this](runtime::Answer& a) { answer(a); };
  stage.answer(stage.keys().all_tiles(), reply);
  stage.answer(stage.keys().of(Key::kMapOdometry), reply);
  stage.answer(stage.keys().all_kept_submaps(), reply);
  stage.on_end_of_run([this](std::uint64_t) {
    fetches_left_ = kFetches;
    // This fetch also requests the tiles that were lost at the end of an earlier run.
    not_fetched_.clear();
    stage_.degraded("map", "");
    fetch();
  });
  stage.every(std::chrono::milliseconds(config_.sync_ms), [this] { every_period(); });
  stage.every(kAskEvery, [this] {
    hear_publisher();
    settle_held();
    ask_publisher();
  });
  // What mapping published last, when both are stopped, is still to be stored.
  stage.drain_on_stop(kStopDrain);
  stage.on_stop([this] { finish_fetch(); });
  stage.on_stop([this] {
    sync();
    if (const std::string error = lacks(); !error.empty()) throw runtime::IoError(error);
  });
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
  say_damage();
  say_stranger();
}

/// The map of another robot has other keys, so nobody here finds it.
void StoreStage::say_stranger() const {
  const std::string& own = stage_.keys().robot();
  for (const std::string& key : store_.keys()) {
    const std::string other(Keys::robot_of(key));
    if (other.empty() || other == own) continue;
    const std::string text = config_.path + " holds the map of robot " + other + ", and this is " +
                             own + ": set robot to " + other +
                             " to use it; the first map of this robot replaces it";
    runtime::log_warning(text);
    return stage_.degraded("robot", text);
  }
  stage_.degraded("robot", "");
}

void StoreStage::say_damage() const {
  const Recovery& r = store_.recovery();
  if (!r.damaged && store_.unreadable() == 0) return stage_.degraded("damaged", "");
  std::string text;
  const auto add = [&text](const std::string& part) { text += (text.empty() ? "" : ", ") + part; };
  if (r.cut_bytes > 0) add(std::to_string(r.cut_bytes) + " bytes can't be read");
  if (r.ignored_segments > 0) {
    add(std::to_string(r.ignored_segments) + " files (*.ignored) are not used");
  }
  if (r.missing_files > 0) add(r.missing + " is missing");
  if (const std::uint64_t count = store_.unreadable(); count > 0) {
    add("records of an unknown format: " + std::to_string(count));
  }
  const bool has_ignored = r.ignored_segments + r.cut_bytes > 0;
  stage_.degraded("damaged", config_.path + " is damaged: " + text +
                                 "; restore it from a copy or map again" +
                                 (has_ignored ? ", and remove *.ignored" : ""));
}

void StoreStage::take(const TileMessage& tile) {
  extensions_.tile_came(tile.run(), tile.header().map_id());
  take(*tile, tile.raw().bytes);
}

void StoreStage::take(const msg::MapTile& tile, std::span<const std::uint8_t> bytes) {
  const std::string key = stage_.keys().tile(tile.layer()->str(), tile.i(), tile.j(), tile.k());
  if (const auto generation = generation_of(*tile.header(), key)) {
    put(key, Key::kMapTile, {*generation, tile.header()->term(), tile.version()}, bytes);
  }
  put_early_pose();
}

/// A replay that localizes in the map of another run stores no pose, so that repeating the replay
/// starts from the same state. A replay that extends that map does store its poses.
bool StoreStage::only_looks(const msg::Header& header) const {
  return header.replay() && extensions_.only_looks(header.run(), header.map_id());
}

void StoreStage::take(const PoseMessage& pose) {
  const msg::Header& header = pose.header();
  if (only_looks(header)) return;
  if (!generations_.is_current(header.run(), header.map_id())) {
    // Only tiles and submaps begin a map. A mapping that did not get the map from here publishes
    // poses in a frame of its own, and they must not delete that map.
    early_pose_ = pose;
    publisher_.stored(pose->instant_ns());
    return;
  }
  put_pose(pose);
}

void StoreStage::put_pose(const PoseMessage& pose) {
  const msg::Header& header = pose.header();
  // The version is the instant, because sweep numbers start from 0 in each run of a map.
  const auto version = static_cast<std::uint64_t>(std::max<std::int64_t>(pose->instant_ns(), 0));
  // When the same capture is replayed again, the last pose of the earlier replay would win, and a
  // killed mapping would resume where that replay ended. Start a new map instead, unless the replay
  // extends the map of another run.
  const std::string key = stage_.keys().of(Key::kMapOdometry);
  const auto known = store_.rank(key);
  const bool is_own = header.map_id() == 0 || header.map_id() == header.run();
  const bool again = std::exchange(is_new_, false) && header.replay() && is_own &&
                     pose.sweep() == 0 && known && known->version > version;
  if (again) begin_again(header);
  // A stored pose with an impossible instant dates from before instants were checked: supersede it
  // by a greater term.
  std::uint32_t term = known ? std::max(known->term, header.term()) : header.term();
  if (known && publisher_.is_beyond(static_cast<std::int64_t>(known->version))) ++term;
  publisher_.stored(pose->instant_ns());
  if (const auto generation = generation_of(header, key)) {
    put(key, Key::kMapOdometry, {*generation, term, version}, pose.raw().bytes);
  }
}

/// Whether the message is of a map of which only poses have come.
bool StoreStage::is_of_early_pose(const msg::Header& header) const {
  if (!early_pose_) return false;
  const msg::Header& pose = early_pose_->header();
  return header.map_id() == pose.map_id() && (header.map_id() != 0 || header.run() == pose.run());
}

/// Stores the newest pose that came before the first tile or submap of its map.
void StoreStage::put_early_pose() {
  if (!early_pose_) return;
  const PoseMessage pose = *early_pose_;
  if (!generations_.is_current(pose.run(), pose.header().map_id())) return;
  early_pose_.reset();
  put_pose(pose);
}

// Empty submaps are not stored: the last one of a run only marks its end, and a fixed map gets no
// new points.
void StoreStage::take(const SubmapMessage& submap) {
  const msg::Header& header = submap.header();
  if (structs_of(submap->points()).empty()) return;
  const std::string key = stage_.keys().kept_submap(submap->instant_ns());
  if (const auto generation = generation_of(header, key)) {
    put(key, Key::kSubmap, {*generation, header.term(), 0}, submap.raw().bytes);
  }
  put_early_pose();
}

void StoreStage::not_stored(const std::string& key, const std::string& why) {
  if (unstored_.empty()) runtime::log_error("not stored", {{"key", key}, {"what", why}});
  unstored_.insert(key);
  disk_error_ = why;
}

void StoreStage::put(const std::string& key, Key kind, const Rank& rank,
                     std::span<const std::uint8_t> bytes) {
  try {
    const StoredMessage message{key, encoding_of(kind), rank, {bytes.begin(), bytes.end()}};
    if (store_.put(message) == PutResult::kOld) {
      ++old_;
      return;
    }
    unstored_.erase(key);
  } catch (const std::system_error& e) {
    not_stored(key, e.what());
  }
  if (store_.unsynced_bytes() >= static_cast<std::uint64_t>(config_.sync_mib) * kMiB) sync();
  say_disk();
}

/// The store remembers a failure; each is told once.
void StoreStage::sync() {
  const bool is_first = store_.sync_error().empty();
  try {
    store_.sync();
  } catch (const std::system_error& e) {
    if (is_first) runtime::log_error("not on disk", {{"what", e.what()}});
  }
}

/// What the folder lacks; empty: nothing.
std::string StoreStage::lacks() const {
  std::string text;
  if (!unstored_.empty()) {
    text = std::to_string(unstored_.size()) + " messages of the map are not in " + config_.path +
           " (" + disk_error_ + "): make room there, and map again or restart mapping";
  }
  if (const std::string& error = store_.sync_error(); !error.empty()) {
    text += (text.empty() ? "" : "; ") + config_.path + " was not written to the disk (" + error +
            "): parts of the map may be lost at a power failure";
  }
  return text;
}

void StoreStage::say_disk() { stage_.degraded("disk", lacks()); }

void StoreStage::answer(runtime::Answer& answer) {
  // A query with parameters asks for messages by number, which only their publisher answers.
  if (!answer.parameters().empty()) return;
  std::size_t unread = 0;
  for (const std::string& key : store_.keys()) {
    if (!key_matches(answer.key(), key)) continue;
    try {
      const auto message = store_.get(key);
      if (message) answer.reply(key, message->encoding, buffer_of(message->payload));
    } catch (const std::exception& e) {
      if (++unread == 1) runtime::log_error("a stored message can't be read", {{"what", e.what()}});
    }
  }
  if (unread == 0) return;
  const std::string text = std::to_string(unread) + " messages in " + config_.path +
                           " can't be read: the map in the answers lacks them";
  stage_.degraded("unread", text);
  answer.refuse(text);
}

void StoreStage::every_period() {
  take_fetched();
  sync();
  say_disk();
  try {
    if (store_.compact_if_due()) {
      runtime::log_info("compacted", {{"mib", mib(store_.log_bytes())}});
      say_damage();
    }
    stage_.degraded("compaction", "");
  } catch (const std::system_error& e) {
    stage_.degraded("compaction", e.what());
  }
  stage_.figure("keys", static_cast<double>(store_.keys().size()));
  stage_.figure("log_mib", mib(store_.log_bytes()));
  stage_.figure("live_mib", mib(store_.live_bytes()));
  stage_.figure("unsynced_bytes", static_cast<double>(store_.unsynced_bytes()));
  stage_.figure("messages_not_stored", static_cast<double>(unstored_.size()));
  stage_.figure("old_messages", static_cast<double>(old_));
  stage_.figure("unconfirmed_messages", static_cast<double>(unconfirmed_));
}

}  // namespace zloam::store
