#pragma once
// When to request all of something, and when to request it again because not all of it came: after
// a pause that doubles, so that whoever is too slow to answer is not asked without end.

#include <algorithm>
#include <cstdint>
#include <optional>

namespace zloam::runtime {

class AskAgain {
 public:
  static constexpr std::int64_t kFirstPause_ns = 2'000'000'000, kLongestPause_ns = 60'000'000'000;

  /// Asks at once.
  void want() {
    wanted_ = true;
    not_before_ns_.reset();
  }
  /// now_ns: time of any monotonic clock.
  bool due(std::int64_t now_ns) const {
    return wanted_ && (!not_before_ns_ || now_ns >= *not_before_ns_);
  }
  void asked() { wanted_ = false; }
  /// All that was asked for has come, or not.
  void answered(bool whole, std::int64_t now_ns) {
    if (whole) {
      pause_ns_ = kFirstPause_ns;
      return;
    }
    // What was wanted since the question is asked for at once.
    if (wanted_) return;
    wanted_ = true;
    not_before_ns_ = now_ns + pause_ns_;
    pause_ns_ = std::min(2 * pause_ns_, kLongestPause_ns);
  }

 private:
  bool wanted_ = false;
  std::optional<std::int64_t> not_before_ns_;
  std::int64_t pause_ns_ = kFirstPause_ns;
};

}  // namespace zloam::runtime
