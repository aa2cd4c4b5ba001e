#pragma once
// Three indices of a grid as one number, for tables accessed by key.

#include <array>
#include <cstdint>

namespace zloam {

constexpr int kGridKeyBits = 21;
constexpr std::int32_t kGridKeyOffset = std::int32_t{1} << (kGridKeyBits - 1);
constexpr std::uint64_t kGridKeyMask = (std::uint64_t{1} << kGridKeyBits) - 1;

/// Indices of -2^20 to 2^20 - 1 have unique keys. The highest bit of a key is clear.
inline std::uint64_t grid_key(std::int64_t i, std::int64_t j, std::int64_t k) {
  const auto part = [](std::int64_t n) {
    return static_cast<std::uint64_t>(n + kGridKeyOffset) & kGridKeyMask;
  };
  return part(i) << (2 * kGridKeyBits) | part(j) << kGridKeyBits | part(k);
}

inline std::array<std::int32_t, 3> grid_indices(std::uint64_t key) {
  const auto part = [key](int n) {
    return static_cast<std::int32_t>(key >> (n * kGridKeyBits) & kGridKeyMask) - kGridKeyOffset;
  };
  return {part(2), part(1), part(0)};
}

}  // namespace zloam
