#pragma once
// The time from sweep to sweep by their stamps, also where messages of some sweeps only come: the
// median of the last few, so that a single message, from any sender, does not change it.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

namespace zloam::runtime {

class SweepPeriod {
 public:
  /// Of any sensor.
  static constexpr std::int64_t kFastest_ns = 10'000'000;

  /// The period before counts until the run's own is measured.
  void begin_run() {
    last_.reset();
    count_ = 0;
  }
  void add(std::uint64_t sweep, std::int64_t stamp_ns) {
    const auto before = last_.value_or(std::pair(sweep, stamp_ns));
    last_ = {sweep, stamp_ns};
    std::int64_t since_ns = 0;
    if (sweep <= before.first || sweep - before.first > kMostNumbers) return;
    if (__builtin_sub_overflow(stamp_ns, before.second, &since_ns)) return;
    const std::int64_t period_ns = since_ns / static_cast<std::int64_t>(sweep - before.first);
    if (period_ns <= kShortest_ns || period_ns >= kLongest_ns) return;
    measured_[count_++ % measured_.size()] = period_ns;
    auto sorted = measured_;
    const auto end = sorted.begin() + static_cast<std::ptrdiff_t>(std::min(count_, sorted.size()));
    const auto middle = sorted.begin() + (end - sorted.begin()) / 2;
    std::nth_element(sorted.begin(), middle, end);
    period_ns_ = *middle;
  }
  std::int64_t ns() const { return period_ns_; }
  /// In this run.
  bool is_measured() const { return count_ > 0; }

 private:
  static constexpr std::uint64_t kMostNumbers = 1'000'000;
  static constexpr std::int64_t kShortest_ns = 1'000'000, kLongest_ns = 10'000'000'000;
  std::optional<std::pair<std::uint64_t, std::int64_t>> last_;
  std::array<std::int64_t, 9> measured_{};
  std::size_t count_ = 0;
  std::int64_t period_ns_ = 100'000'000;
};

}  // namespace zloam::runtime
