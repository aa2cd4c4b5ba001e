#pragma once
// Keeps the newest message of each key on disk. Newest is the greatest (map_id, term, version), not
// the last received (docs/protocol.md, section 9): a late copy from before a take-over changes
// nothing. A greater map_id makes tiles of lesser ones obsolete; the next compaction removes them.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <tuple>
#include <vector>

#include "store/record_log.hpp"

namespace zloam::store {

struct Rank {
  std::uint64_t map_id = 0;
  std::uint32_t term = 0;
  std::uint64_t version = 0;
  auto tie() const { return std::tie(map_id, term, version); }
  bool operator<(const Rank& other) const { return tie() < other.tie(); }
  bool operator==(const Rank& other) const { return tie() == other.tie(); }
};

struct StoredMessage {
  std::string key;
  std::string encoding;
  Rank rank;
  std::vector<std::uint8_t> payload;
};

struct StoreLimits {
  LogLimits log;
  /// compaction starts when the log is larger than this many times the valid bytes ...
  double garbage_factor = 3.0;
  /// ... and than this
  std::uint64_t compact_bytes = 256U << 20;
};

/// kOld: a greater or equal rank is there.
enum class PutResult : std::uint8_t { kStored, kOld };

class TileStore {
 public:
  TileStore(const std::filesystem::path& folder, const StoreLimits& limits,
            Access access = Access::kWrite);

  PutResult put(const StoredMessage& message);
  std::optional<StoredMessage> get(const std::string& key) const;
  std::optional<Rank> rank(const std::string& key) const;
  /// In ascending order.
  std::vector<std::string> keys() const;

  void sync() { log_.sync(); }
  const std::string& sync_error() const { return log_.sync_error(); }
  std::uint64_t unsynced_bytes() const { return log_.unsynced_bytes(); }
  /// Compacts if the limits require it, or a new map was begun in a folder that lacks files, which
  /// would be missed at each start; true: done.
  bool compact_if_due();
  void compact();
  /// The files that hold all messages so far; none of them changes any more (earlier_maps.hpp).
  std::vector<std::filesystem::path> close_files() { return log_.close_files(); }

  std::uint64_t live_bytes() const { return live_bytes_; }
  std::uint64_t log_bytes() const { return log_.bytes(); }
  std::uint64_t newest_map() const { return newest_map_; }
  const Recovery& recovery() const { return log_.recovery(); }
  /// whole records of an unknown format, as of a later version; a compaction drops them
  std::uint64_t unreadable() const { return unreadable_; }

 private:
  struct Entry {
    Rank rank;
    Place place;
  };
  void note(const std::string& key, const Rank& rank, const Place& place);
  void on_record(std::span<const std::uint8_t> body, const Place& place);

  StoreLimits limits_;
  // Before the log, whose recovery fills them.
  std::map<std::string, Entry> entries_;
  std::uint64_t live_bytes_ = 0;
  std::uint64_t newest_map_ = 0;
  std::uint64_t unreadable_ = 0;
  /// only an earlier map can be in the files that the folder lacks
  bool lacks_only_older_ = false;
  RecordLog log_;
};

/// Encodes the body of a record, and decodes it; nothing for an invalid body.
std::vector<std::uint8_t> pack(const StoredMessage& message);
std::optional<StoredMessage> unpack(std::span<const std::uint8_t> body, bool with_payload);

}  // namespace zloam::store
