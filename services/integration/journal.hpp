#pragma once
// Keeps the poses of a run on disk while it lasts, so that an integration that is killed and
// started again continues the trajectory. A private format: the poses are exact to the bit. Nothing
// is synced: of a power failure the journal survives up to the first record that the disk lacks.

#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::integration {

struct JournalPose {
  std::uint64_t run = 0;
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_base = Pose::Identity();
  Pose T_odom_base = Pose::Identity();
  bool replay = false;
};

/// Drops the poses after the one of this run and sweep: each run counts its sweeps from 0. False,
/// and nothing is dropped: that pose is not among them.
bool drop_after(std::vector<JournalPose>& poses, std::uint64_t run, std::uint64_t sweep);

class Journal {
 public:
  /// Empty path: none is kept.
  explicit Journal(std::string path) : path_(std::move(path)) {}
  ~Journal() { close(); }
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// The poses on disk, up to the first record that was cut short or is damaged.
  std::vector<JournalPose> read() const;
  /// A journal of which nothing can be read, such as one of another version, gets another name,
  /// which is returned; empty: there is none.
  std::string keep_unread() const;
  /// The same for a live run's journal whose poses could not be written to the run's files, as on a
  /// full disk: the next begin() would leave them nowhere. Poses that find no room until now are
  /// not in it: see is_behind(). A replay can be repeated.
  std::string keep_unwritten();
  /// Starts a new journal that holds these poses.
  std::string begin(const std::vector<JournalPose>& poses);
  /// Empty, or a sentence that says what failed, once. Poses that find no room are written before a
  /// later one, when there is room again.
  std::string append(const JournalPose& pose);
  bool is_behind() const { return !waiting_.empty(); }
  /// Called once the run's files are written.
  void remove();

 private:
  void close();
  std::string set_aside(const std::string& ending) const;
  bool write_waiting();
  std::string path_;
  int descriptor_ = -1;
  /// of the records that are whole
  std::int64_t bytes_ = 0;
  std::deque<JournalPose> waiting_;
};

}  // namespace zloam::integration
