#pragma once
// Latencies in bounded memory, and the kernel's figures of this process.

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <vector>

namespace zloam::runtime {

struct LatencySummary {
  std::string name;
  std::uint64_t count = 0;
  double p50_ms = 0, p95_ms = 0, p99_ms = 0, max_ms = 0;
};

/// Percentiles over an even choice of samples: when full, every second sample is discarded, and
/// from then on only every second new one is kept, and so on. The maximum is over all. Any thread.
class Latencies {
 public:
  void add(const std::string& name, double milliseconds);
  std::vector<LatencySummary> summaries() const;

 private:
  static constexpr std::size_t kCapacity = 4096;
  struct Series {
    std::vector<double> samples;
    std::uint64_t count = 0;
    std::uint64_t stride = 1;
    double max = 0;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Series> series_;
};

struct ProcessUsage {
  double cpu_ms = 0;
  double rss_mib = 0;
  double rss_peak_mib = 0;
  /// parts of rss_mib: this process's own, and shared memory, counted in every process that maps it
  double rss_anon_mib = 0, rss_shm_mib = 0;
};
ProcessUsage process_usage();

/// Call it before other threads start: free memory beyond a block of this size goes back to the
/// system instead of staying in one heap for each thread.
void bound_heap(int kept_block_bytes);
/// Returns all free heap memory to the system, also memory freed from then on: after a message that
/// was larger than allowed.
void give_back_heap();
/// Restores the setting of bound_heap().
void keep_heap();

}  // namespace zloam::runtime
