#pragma once
// The time from sweep to sweep by their stamps: the median of the last few, so that a single
// message, from any sender, does not change it.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

namespace zloam::runtime {

class SweepPeriod {
 public:
  void begin_run() { last_.reset(); }
  void add(std::uint64_t sweep, std::int64_t stamp_ns) {
    const std::int64_t before_ns = last_ ? last_->second : 0;
    const bool next = last_ && sweep == last_->first + 1;
    last_ = {sweep, stamp_ns};
    std::int64_t period_ns = 0;
    if (!next || __builtin_sub_overflow(stamp_ns, before_ns, &period_ns)) return;
    if (period_ns <= kShortest_ns || period_ns >= kLongest_ns) return;
    measured_[count_++ % measured_.size()] = period_ns;
    auto sorted = measured_;
    const auto end = sorted.begin() + static_cast<std::ptrdiff_t>(std::min(count_, sorted.size()));
    const auto middle = sorted.begin() + (end - sorted.begin()) / 2;
    std::nth_element(sorted.begin(), middle, end);
    period_ns_ = *middle;
  }
  std::int64_t ns() const { return period_ns_; }

 private:
  static constexpr std::int64_t kShortest_ns = 1'000'000, kLongest_ns = 10'000'000'000;
  std::optional<std::pair<std::uint64_t, std::int64_t>> last_;
  std::array<std::int64_t, 9> measured_{};
  std::size_t count_ = 0;
  std::int64_t period_ns_ = 100'000'000;
};

}  // namespace zloam::runtime
