#pragma once
// How far ahead the number of a live sweep can be: no further than sweeps can have been made in the
// time since. A higher number is forged or damaged, and must not make the true ones late. The very
// next number is never refused, however soon it arrives: some sources are faster than their stamps.
// Times are of any monotonic clock, ns.

#include <algorithm>
#include <cstdint>

namespace zloam::runtime {

class NumberCredit {
 public:
  void begin(std::int64_t now_ns) {
    credit_ = kSlack + 1.0;
    at_ns_ = now_ns;
  }
  /// Whether the next number may be this far beyond the expected one; if so, it is accepted.
  bool spend(std::uint64_t beyond, std::int64_t period_ns, std::int64_t now_ns) {
    // After continue_at() there is no time to count from.
    if (at_ns_ == 0) at_ns_ = now_ns;
    credit_ += kPace * static_cast<double>(now_ns - at_ns_) / static_cast<double>(period_ns);
    at_ns_ = now_ns;
    const double numbers = static_cast<double>(beyond) + 1.0;
    if (beyond > 0 && numbers > credit_) return false;
    // The very next number uses only credit saved during a stall: in the burst after the stall one
    // number may be missing after any number that came in order.
    const double least = beyond > 0 ? 0.0 : std::min(credit_, kSlack);
    credit_ = std::max(credit_ - numbers, least);
    // Credit saved during a stall is for the messages delayed by it.
    if (credit_ > kSlack) credit_ = kSlack + kKept * (credit_ - kSlack);
    return true;
  }

 private:
  /// tolerance for clocks, and for a measured period
  static constexpr double kPace = 1.02;
  /// burst size when links or publishers have just come up; a forger gets no more either
  static constexpr double kSlack = 8.0;
  static constexpr double kKept = 0.995;
  double credit_ = kSlack;
  std::int64_t at_ns_ = 0;
};

}  // namespace zloam::runtime
