#pragma once
// The poses of a run, one after the other on disk while it lasts: an integration that is killed and
// started again goes on with the trajectory of the one before. Not for reading by others; what is
// in it is exact to the bit. Nothing is synced: it survives the process, not a power failure.

#include <cstdint>
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
};

class Journal {
 public:
  /// Empty path: none is kept.
  explicit Journal(std::string path) : path_(std::move(path)) {}
  ~Journal() { close(); }
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  /// What is there; a record that was cut short ends it.
  std::vector<JournalPose> read() const;
  /// Begins a new one, with what is to stand in it.
  std::string begin(const std::vector<JournalPose>& poses);
  /// Empty, or a sentence that says what failed.
  std::string append(const JournalPose& pose);
  /// The run's files are written.
  void remove();

 private:
  void close();
  std::string path_;
  int descriptor_ = -1;
};

}  // namespace zloam::integration
