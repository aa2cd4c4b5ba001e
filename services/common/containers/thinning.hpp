#pragma once
// Thinning of a dense sweep: never below a sufficient number, and the choice of its points.

#include <algorithm>
#include <cstddef>

namespace zloam {

/// The greatest stride through `items` that leaves at least `enough` of them; at least 1.
inline std::size_t stride_to(std::size_t enough, std::size_t items) {
  return std::max<std::size_t>(items / std::max<std::size_t>(enough, 1), 1);
}

/// Selects every stride-th stretch of `together` successive items, beginning with stretch `first`.
/// A sweep's points are given ring by ring, so that each ring has its share. (In time order, every
/// second point of a full sweep would be every second ring.) If `first` changes from sweep to
/// sweep, all points are used in turn.
struct Thinning {
  std::size_t stride = 1;
  std::size_t first = 0;
  std::size_t together = 1;

  /// Calls take(begin, end) for each stretch, in order.
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

  /// Calls take(item) for each selected item, in order.
  template <typename Items, typename Take>
  void each(const Items& items, const Take& take) const {
    each_stretch(items.size(), [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) take(items[i]);
    });
  }
};

/// For points counted in voxels: neighbours of one ring mostly share their voxel, so that fewer
/// voxels are touched (HDL-64E: a seventh less time of odometry and mapping; the same errors).
inline constexpr std::size_t kCountedTogether = 4;

}  // namespace zloam
