#pragma once
// How far a dense sweep is thinned: never below what is enough, and which of its points are left.

#include <algorithm>
#include <cstddef>

namespace zloam {

/// The greatest stride through so many items that leaves no fewer than enough of them; at least 1.
inline std::size_t stride_to(std::size_t enough, std::size_t items) {
  return std::max<std::size_t>(items / std::max<std::size_t>(enough, 1), 1);
}

/// Of a row of items every stride-th stretch of `together` successive ones, the first stretch
/// chosen by `first`. A sweep's points are given ring by ring, so that each ring has its share.
/// (Counted through time slots, every second point of a full sweep is every second ring.) Where the
/// first one changes from sweep to sweep, all points have their turn.
struct Thinning {
  std::size_t stride = 1;
  std::size_t first = 0;
  std::size_t together = 1;

  /// take(begin, end) for each stretch, in order.
  template <typename Take>
  void each_stretch(std::size_t items, const Take& take) const {
    if (stride == 1) {
      take(std::size_t{0}, items);
      return;
    }
    for (std::size_t begin = first % stride * together; begin < items; begin += stride * together) {
      take(begin, std::min(begin + together, items));
    }
  }

  /// take(item) for each one that is left, in order.
  template <typename Items, typename Take>
  void each(const Items& items, const Take& take) const {
    each_stretch(items.size(), [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) take(items[i]);
    });
  }
};

/// Of points that are counted in voxels: neighbours of one ring mostly share their voxel, so that
/// fewer are touched (HDL-64E: a seventh less time of odometry and mapping; the same errors).
inline constexpr std::size_t kCountedTogether = 4;

}  // namespace zloam
