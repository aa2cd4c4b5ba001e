#pragma once
// Why a request was refused, for the status: the stage works as well as before, so that the reason
// passes after a while.

#include <cstdint>
#include <string>
#include <utility>

namespace zloam::ros {

class PassingReason {
 public:
  /// How long it shows.
  static constexpr std::int64_t kShown_ns = 30'000'000'000;

  /// Empty: the request was taken, and no earlier reason holds. now_ns: time of any monotonic
  /// clock.
  void say(std::string reason, std::int64_t now_ns) {
    reason_ = std::move(reason);
    said_ns_ = now_ns;
  }
  const std::string& shown(std::int64_t now_ns) {
    if (now_ns - said_ns_ > kShown_ns) reason_.clear();
    return reason_;
  }

 private:
  std::string reason_;
  std::int64_t said_ns_ = 0;
};

}  // namespace zloam::ros
