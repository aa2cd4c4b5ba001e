#pragma once
// Whether a sweep fits as well as the ones before. A matching that ends at a wrong place has
// usually not converged, and explains far fewer of its points than the sweeps before it did; one at
// the right place explains as many even where much is new.

#include <algorithm>
#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

namespace zloam {

class FitRecord {
 public:
  /// Number of fits remembered; a restarted stage restores as many.
  static constexpr std::size_t kRemembered = 10;

  /// Adds the fit of a sweep whose matching converged.
  void add(double fit) {
    fits_.push_back(fit);
    if (fits_.size() > kRemembered) fits_.pop_front();
  }

  /// The median; nothing while there are too few values.
  std::optional<double> usual() const {
    constexpr std::size_t kFewest = 3;
    if (fits_.size() < kFewest) return std::nullopt;
    std::vector<double> sorted(fits_.begin(), fits_.end());
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    return *middle;
  }

  /// The whole state, to save or restore it.
  template <class Bits>
  void each(Bits& bits) {
    bits(fits_);
  }

 private:
  std::deque<double> fits_;
};

}  // namespace zloam
