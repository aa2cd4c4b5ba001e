#pragma once
// Whether the instance that works does anything: what a standby looks at (docs/protocol.md, section
// 6). Without clock or transport; any thread. Times are of any monotonic clock, ns.

#include <cstddef>
#include <cstdint>
#include <mutex>

namespace zloam::runtime {

class ProgressWatch {
 public:
  /// stall_ns: what one sweep may take.
  explicit ProgressWatch(std::int64_t stall_ns) : stall_ns_(stall_ns) {}

  /// Another instance works from now on: it is given time to take up what the one before knew.
  void begin();
  /// A sweep for it came, or something of it.
  void input(std::int64_t now_ns);
  void output();
  /// Sweeps come, and nothing has come of them for too long.
  bool stalls(std::int64_t now_ns) const;

 private:
  std::int64_t stall_ns_;
  mutable std::mutex mutex_;
  std::size_t unanswered_ = 0;
  std::int64_t unanswered_since_ns_ = 0;
  bool has_worked_ = false;
};

}  // namespace zloam::runtime
