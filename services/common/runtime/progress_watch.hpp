#pragma once
// Whether the active instance makes progress: watched by a standby (docs/protocol.md, section 6).
// Without clock or transport; any thread. Times are of any monotonic clock, ns.

#include <cstddef>
#include <cstdint>
#include <mutex>

namespace zloam::runtime {

class ProgressWatch {
 public:
  /// stall_ns: longest time for one sweep.
  explicit ProgressWatch(std::int64_t stall_ns) : stall_ns_(stall_ns) {}

  /// Another instance is active from now on: it gets time to restore the state of the one before.
  void begin();
  /// A sweep for it arrived, or a sign that it works on them.
  void input(std::int64_t now_ns);
  void output();
  /// Sweeps arrive, and there has been no sign of work for too long.
  bool stalls(std::int64_t now_ns) const;

 private:
  std::int64_t stall_ns_;
  mutable std::mutex mutex_;
  std::size_t unanswered_ = 0;
  std::int64_t unanswered_since_ns_ = 0;
  bool has_worked_ = false;
};

}  // namespace zloam::runtime
