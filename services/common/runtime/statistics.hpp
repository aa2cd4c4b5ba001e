#pragma once
// Latencies in bounded memory, and what the kernel says of this process.

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

/// Percentiles over an even choice of samples: when full, every second one is forgotten and from
/// then on only every second newcomer is taken, and so on. The maximum is over all. Any thread.
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
  /// of rss_mib: this process' own, and shared memory, which every process that has it open counts
  double rss_anon_mib = 0, rss_shm_mib = 0;
};
ProcessUsage process_usage();

/// To be called before other threads start: what is freed beyond a block of this size goes back to
/// the system instead of staying in one heap for each thread.
void bound_heap(int kept_block_bytes);
/// All of the heap that is free goes back to the system, and so does what is freed from then on:
/// after what was larger than it should be.
void give_back_heap();
/// As bound_heap() said, again.
void keep_heap();

}  // namespace zloam::runtime
