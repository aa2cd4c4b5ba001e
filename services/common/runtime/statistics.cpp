#include "common/runtime/statistics.hpp"

#include <malloc.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>

namespace zloam::runtime {
namespace {

/// Nearest-rank percentile of sorted samples.
double percentile(const std::vector<double>& sorted, double fraction) {
  const auto rank =
      static_cast<std::size_t>(std::ceil(fraction * static_cast<double>(sorted.size())));
  return sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
}

double milliseconds(const timeval& t) {
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) * 1e-3;
}

}  // namespace

void Latencies::add(const std::string& name, double value) {
  const std::lock_guard lock(mutex_);
  Series& s = series_[name];
  s.max = std::max(s.max, value);
  if (s.count++ % s.stride != 0) return;
  s.samples.push_back(value);
  if (s.samples.size() < kCapacity) return;
  for (std::size_t i = 0; 2 * i < s.samples.size(); ++i) s.samples[i] = s.samples[2 * i];
  s.samples.resize((s.samples.size() + 1) / 2);
  s.stride *= 2;
}

std::vector<LatencySummary> Latencies::summaries() const {
  std::map<std::string, Series> copy;
  {
    const std::lock_guard lock(mutex_);
    copy = series_;
  }
  std::vector<LatencySummary> all;
  for (auto& [name, s] : copy) {
    std::sort(s.samples.begin(), s.samples.end());
    all.push_back({name, s.count, percentile(s.samples, 0.50), percentile(s.samples, 0.95),
                   percentile(s.samples, 0.99), s.max});
  }
  return all;
}

ProcessUsage process_usage() {
  ProcessUsage usage;
  rusage r{};
  if (getrusage(RUSAGE_SELF, &r) == 0) {
    usage.cpu_ms = milliseconds(r.ru_utime) + milliseconds(r.ru_stime);
  }
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    double* field = word == "VmRSS:"      ? &usage.rss_mib
                    : word == "VmHWM:"    ? &usage.rss_peak_mib
                    : word == "RssAnon:"  ? &usage.rss_anon_mib
                    : word == "RssShmem:" ? &usage.rss_shm_mib
                                          : nullptr;
    double kib = 0;
    if (field != nullptr && status >> kib) *field = kib / 1024.0;
  }
  return usage;
}

namespace {
#ifdef __GLIBC__
std::atomic<int> kept_bytes = 0;
// While memory is given back: free memory at an arena's end is returned from this size on.
constexpr int kGivenBack_bytes = 1 << 20;
#endif
}  // namespace

void bound_heap([[maybe_unused]] int kept_block_bytes) {
#ifdef __GLIBC__
  kept_bytes = kept_block_bytes;
  // Set explicitly, because glibc would raise them by itself. Smaller blocks come from the heap,
  // where a small block above them keeps them from being returned.
  mallopt(M_MMAP_THRESHOLD, kept_block_bytes);
  mallopt(M_TRIM_THRESHOLD, kept_block_bytes);
  mallopt(M_ARENA_MAX, 2);
#endif
}

void give_back_heap() {
#ifdef __GLIBC__
  // malloc_trim trims only the first arena's end; the others are trimmed at their next free, from
  // this threshold on.
  if (kept_bytes > 0) mallopt(M_TRIM_THRESHOLD, std::min<int>(kept_bytes, kGivenBack_bytes));
  malloc_trim(0);
#endif
}

void keep_heap() {
#ifdef __GLIBC__
  if (kept_bytes > 0) mallopt(M_TRIM_THRESHOLD, kept_bytes);
#endif
}

}  // namespace zloam::runtime
