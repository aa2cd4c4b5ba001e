#pragma once
// Messages of a topic that can't be used, for a status that is sent once a second while the
// messages come more often: a few of many must show, too.

#include <cstddef>
#include <cstdint>

namespace zloam::ros {

class Unusable {
 public:
  /// How long the last one shows.
  static constexpr std::int64_t kShown_ns = 5'000'000'000;

  /// now_ns: time of any monotonic clock.
  void add(std::size_t messages, std::int64_t now_ns) {
    if (messages == 0) return;
    count_ += messages;
    last_ns_ = now_ns;
  }
  /// All since the first one; 0 when none has come for a while.
  std::uint64_t shown(std::int64_t now_ns) {
    if (count_ > 0 && now_ns - last_ns_ > kShown_ns) count_ = 0;
    return count_;
  }

 private:
  std::uint64_t count_ = 0;
  std::int64_t last_ns_ = 0;
};

}  // namespace zloam::ros
