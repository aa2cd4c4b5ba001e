// Begins another map in the store, and keeps the one before.
#include <algorithm>
#include <stdexcept>
#include <system_error>

#include "store/earlier_maps.hpp"
#include "store/store_stage.hpp"

namespace zloam::store {
namespace {

template <class T>
bool is_of_replay(const StoredMessage& m) {
  return verify<T>(m.payload, m.encoding).ok() && message_of<T>(m.payload).header()->replay();
}

/// False: surely a replay's, or the store's own record of its map, which has no encoding.
bool may_be_live(const StoredMessage& m) {
  return !m.encoding.empty() && !is_of_replay<msg::MapPose>(m) && !is_of_replay<msg::Submap>(m) &&
         !is_of_replay<msg::MapTile>(m);
}

}  // namespace

/// A live drive can't be repeated; the map of a replay can be made again from its recording. A part
/// of a live run is enough: a replay may have extended its map.
bool StoreStage::has_live_map() {
  if (!has_live_) {
    has_live_ = std::ranges::any_of(store_.keys(), [this](const std::string& key) {
      try {
        return may_be_live(store_.get(key).value());
      } catch (const std::exception&) {
        return true;  // What can't be read may be a live run's.
      }
    });
  }
  return *has_live_;
}

/// Whatever fails here, the other map begins.
void StoreStage::keep_earlier() {
  if (!has_live_map()) return;
  std::string error;
  try {
    if (const auto kept = keep_earlier_map(config_.path, store_.close_files())) {
      runtime::log_info("another map begins; the earlier one is kept", {{"path", kept->string()}});
    }
  } catch (const std::exception& e) {
    error = "the map before this one is not kept (" + std::string(e.what()) + "): make room in " +
            config_.path +
            ", use a file system with hard links, or copy the folder before each run";
    if (keep_error_ != error) runtime::log_warning(error);
  }
  keep_error_ = error;
  stage_.degraded("earlier", error);
  remove_oldest();
}

void StoreStage::remove_oldest() {
  try {
    while (const auto removed = remove_oldest_map(config_.path)) {
      runtime::log_info("the oldest of the earlier maps is removed", {{"path", removed->string()}});
    }
    stage_.degraded("oldest", "");
  } catch (const std::exception& e) {
    stage_.degraded("oldest", "the oldest of the earlier maps is still there (" +
                                  std::string(e.what()) + "): remove it from " + config_.path);
  }
}

void StoreStage::begin(const msg::Header& header) {
  keep_earlier();
  generations_.begin(header.run(), header.map_id());
  // What an obsolete map lacks is of no interest.
  unstored_.clear();
  stage_.degraded("robot", "");
  has_live_ = false;
}

void StoreStage::begin_again(const msg::Header& header) {
  try {
    begin(header);
  } catch (const std::system_error& e) {
    not_stored(stage_.keys().of(Key::kMapOdometry), e.what());
  }
}

/// Number of the message's map, which is written to the disk when it is a new one; nothing: that
/// failed, and the message is not stored.
std::optional<std::uint64_t> StoreStage::generation_of(const msg::Header& header,
                                                       const std::string& key) {
  try {
    if (!generations_.is_current(header.run(), header.map_id())) begin(header);
    if (!header.replay()) has_live_ = true;
    return generations_.current();
  } catch (const std::system_error& e) {
    not_stored(key, e.what());
    say_disk();
    return std::nullopt;
  }
}

}  // namespace zloam::store
