#pragma once
// A box and the rays through it, for the worlds of the tests. Shares no code with what they test.

#include <algorithm>
#include <limits>
#include <utility>

#include "common/geometry/se3.hpp"

namespace zloam::test {

struct Box {
  Eigen::Vector3d low, high;
};

/// Where the ray enters and leaves the box.
inline std::pair<double, double> slab(const Box& box, const Eigen::Vector3d& from,
                                      const Eigen::Vector3d& ray) {
  double near = -std::numeric_limits<double>::infinity();
  double far = std::numeric_limits<double>::infinity();
  for (int a = 0; a < 3; ++a) {
    const double inverse = 1.0 / (ray[a] == 0.0 ? 1e-12 : ray[a]);
    const double t0 = (box.low[a] - from[a]) * inverse;
    const double t1 = (box.high[a] - from[a]) * inverse;
    near = std::max(near, std::min(t0, t1));
    far = std::min(far, std::max(t0, t1));
  }
  return {near, far};
}

}  // namespace zloam::test
