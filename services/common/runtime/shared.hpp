#pragma once
// State shared by the threads of a stage: the one mutex of all accounts and incoming queues, the
// bell that wakes the worker, the counters of the transport, the clocks.

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>

#include "common/runtime/fault.hpp"
#include "common/zenoh/aligned.hpp"

namespace zloam::runtime {

/// Host clock, ns since the Unix epoch.
inline std::int64_t wall_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
             .count() +
         clock_fault_ns();
}

/// Monotonic, ns since an arbitrary instant.
inline std::int64_t steady_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// Nanoseconds in a millisecond.
inline constexpr std::int64_t kMs = 1'000'000;

struct Shared {
  std::mutex mutex;
  std::condition_variable bell;
  bool rung = false;
  zenoh::TransferCounters transfer;
  /// messages larger than the limit of their key
  std::uint64_t oversized = 0;

  void notify() {
    {
      const std::lock_guard lock(mutex);
      rung = true;
    }
    bell.notify_all();
  }

  /// Waits until the bell has rung since the last wait, or until the monotonic time.
  void wait_until(std::int64_t steady_deadline_ns) {
    std::unique_lock lock(mutex);
    const std::chrono::steady_clock::time_point deadline(
        std::chrono::duration_cast<std::chrono::steady_clock::duration>(
            std::chrono::nanoseconds(steady_deadline_ns)));
    bell.wait_until(lock, deadline, [this] { return rung; });
    rung = false;
  }
};

}  // namespace zloam::runtime
