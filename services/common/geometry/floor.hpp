#pragma once
// Rounding down to an integer. std::floor is a call on machines of the x86-64 baseline, which have
// no instruction for it.

namespace zloam {

/// x must lie within Int's range.
template <typename Int, typename Real>
constexpr Int floor_to(Real x) {
  const auto cut = static_cast<Int>(x);
  return cut - static_cast<Int>(static_cast<Real>(cut) > x);
}

}  // namespace zloam
