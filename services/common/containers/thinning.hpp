#pragma once
// How far a dense sweep is thinned: never below what is enough.

#include <algorithm>
#include <cstddef>

namespace zloam {

/// The greatest stride through so many items that leaves no fewer than enough of them; at least 1.
inline std::size_t stride_to(std::size_t enough, std::size_t items) {
  return std::max<std::size_t>(items / std::max<std::size_t>(enough, 1), 1);
}

}  // namespace zloam
