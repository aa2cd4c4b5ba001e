#pragma once
// Records on disk: {length u32, crc32c u32, body} after one another, little endian, in segments
// 00000001.log, 00000002.log, ... A compaction writes all valid records into one file <n>.base,
// which replaces all segments up to n: written under a temporary name, synced, renamed, folder
// synced; only then the segments are removed. At the start the newest base is read, then the
// segments above it; the first bad record ends the log, is cut off, and later segments are set
// aside as *.ignored.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "store/file.hpp"

namespace zloam::store {

/// Position of a body.
struct Place {
  std::uint64_t file = 0;
  bool base = false;
  std::uint64_t offset = 0;
  std::uint32_t size = 0;
};

struct LogLimits {
  std::uint64_t segment_bytes = 64U << 20;
  /// a longer record is treated as broken
  std::uint32_t record_bytes = 512U << 20;
};

/// kRead: nothing on disk is changed, nothing can be appended. Another process may write meanwhile: the
/// files are read as they are at the start, also after the other one has compacted them.
enum class Access : std::uint8_t { kWrite, kRead };

struct Recovery {
  std::uint64_t records = 0;
  std::uint64_t bytes = 0;
  /// bytes cut off at the end of the log; segments after it, and files that were set aside earlier
  /// (*.ignored), which nothing is read from
  std::uint64_t cut_bytes = 0;
  std::uint64_t ignored_segments = 0;
  /// number and names of files that are not there although later ones are
  std::uint64_t missing_files = 0;
  std::string missing;
  /// More is missing than the one record that a kill or a power failure cuts short.
  bool damaged = false;
};

class RecordLog {
 public:
  using OnRecord = std::function<void(std::span<const std::uint8_t> body, const Place& place)>;

  /// Creates the folder or recovers its content, calling on_record for each record in order. Throws
  /// std::system_error when the folder can't be used, or another process uses it.
  RecordLog(std::filesystem::path folder, const LogLimits& limits, const OnRecord& on_record,
            Access access = Access::kWrite);

  /// After it returns a kill loses nothing; a power failure loses unsynced records.
  Place append(std::span<const std::uint8_t> body);
  /// Bytes that a power failure would lose.
  std::uint64_t unsynced_bytes() const { return unsynced_; }
  void sync();
  /// Why the first sync that failed did so, whoever needed it; empty: none failed. The system may
  /// drop what it could not write, and report the next attempt as good.
  const std::string& sync_error() const { return sync_error_; }

  /// Throws std::system_error if it can't be read, or is damaged.
  std::vector<std::uint8_t> read(const Place& place) const;

  /// Syncs, begins another segment, and returns the files that hold all records so far. Nothing is
  /// written into them again: cutting off what is damaged or compacting makes other files.
  std::vector<std::filesystem::path> close_files();

  /// Replaces everything by the records that `keep` passes to its argument, which returns their new
  /// places. Their old places are valid until remove_compacted(). `bytes`: about what they take;
  /// without room for them, nothing is written.
  void compact(
      std::uint64_t bytes,
      const std::function<void(const std::function<Place(std::span<const std::uint8_t>)>&)>& keep);
  void remove_compacted();
  /// After a compaction: what the folder lacks is no longer wanted.
  void forget_missing();

  std::uint64_t bytes() const { return bytes_; }
  const Recovery& recovery() const { return recovery_; }

 private:
  /// Numbers of the newest base (0: none) and of the segments after it, ascending.
  struct Files {
    std::uint64_t base = 0;
    std::vector<std::uint64_t> segments;
  };
  std::filesystem::path path_of(std::uint64_t number, bool base) const;
  Files files() const;
  /// Opens all files, so that they remain readable; for kRead.
  Files open_files();
  void recover(const OnRecord& on_record);
  void note_missing(std::uint64_t before, std::uint64_t next);
  /// True: complete; false: cut off at a bad record.
  bool read_segment(std::uint64_t number, bool base, const OnRecord& on_record);
  void open_segment();
  void remove_up_to(std::uint64_t number, bool bases);

  std::filesystem::path folder_;
  Access access_;
  std::unique_ptr<FolderLock> lock_;
  LogLimits limits_;
  Recovery recovery_;
  /// (number, is a base) -> file; for kRead
  std::map<std::pair<std::uint64_t, bool>, ReadFile> opened_;
  AppendFile segment_;
  std::uint64_t number_ = 0;
  std::uint64_t unsynced_ = 0;
  std::string sync_error_;
  std::uint64_t bytes_ = 0;
};

}  // namespace zloam::store
