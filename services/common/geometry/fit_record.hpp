#pragma once
// Whether a sweep fits as the ones before did. A matching that ends in a wrong place has usually
// not come to rest there, and explains far fewer of its points than the sweeps before it did; one
// that found its place explains as many even where much is new.

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

namespace zloam {

class FitRecord {
 public:
  /// So many are remembered; a restarted stage takes as many back.
  static constexpr std::size_t kRemembered = 10;

  /// Of a sweep whose matching came to rest.
  void add(double fit) {
    fits_.push_back(fit);
    if (fits_.size() > kRemembered) fits_.pop_front();
  }

  /// The median; nothing while there are too few to judge by.
  std::optional<double> usual() const {
    constexpr std::size_t kFewest = 3;
    if (fits_.size() < kFewest) return std::nullopt;
    std::vector<double> sorted(fits_.begin(), fits_.end());
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    return *middle;
  }

  /// All that it knows, for who keeps or brings it back.
  template <class Bits>
  void each(Bits& bits) {
    bits(fits_);
  }

 private:
  std::deque<double> fits_;
};

}  // namespace zloam
