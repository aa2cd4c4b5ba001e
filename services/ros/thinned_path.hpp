#pragma once
// The poses of a run for display, evenly spaced: RViz needs the shape of the path, and a message
// with each pose of a long run would be megabytes every second.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::ros {

class ThinnedPath {
 public:
  using Entry = std::pair<std::int64_t, Pose>;
  static constexpr std::size_t kMost = 10'000;

  /// Keeps every n-th pose; n doubles when kMost is reached. One that comes late, because its
  /// message was lost at first, is left out: the line would go back and forth. With one that is not
  /// after the first pose the path begins again: the same recording is replayed once more.
  void add(std::int64_t stamp_ns, const Pose& pose) {
    if (added_ > 0 && stamp_ns <= newest_.first) {
      if (stamp_ns > kept_.front().first) return;
      clear();
    }
    newest_ = {stamp_ns, pose};
    if (added_++ % every_ != 0) return;
    kept_.push_back(newest_);
    if (kept_.size() < kMost) return;
    for (std::size_t i = 0; 2 * i < kept_.size(); ++i) kept_[i] = kept_[2 * i];
    kept_.resize((kept_.size() + 1) / 2);
    every_ *= 2;
  }
  /// With another map, which has another frame, the path begins again.
  void in_map(std::uint64_t map_id) {
    if (map_id_ && *map_id_ != map_id) clear();
    map_id_ = map_id;
  }
  void clear() { *this = {}; }
  /// (stamp, pose), in ascending time; the last is the newest one.
  std::vector<Entry> poses() const {
    std::vector<Entry> all = kept_;
    if (!all.empty() && all.back().first != newest_.first) all.push_back(newest_);
    return all;
  }

 private:
  std::vector<Entry> kept_;
  Entry newest_{0, Pose::Identity()};
  std::uint64_t added_ = 0, every_ = 1;
  std::optional<std::uint64_t> map_id_;
};

}  // namespace zloam::ros
