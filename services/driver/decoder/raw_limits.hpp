#pragma once
// Which raw distances in packets (16 bits, some unit) are returns.

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace zloam::driver {

/// Distances that count as returns; raw 0 never does.
struct RawLimits {
  std::uint32_t lowest = 1;
  std::uint32_t span = 65534;
  bool contain(std::uint32_t raw) const { return raw - lowest <= span; }
};

/// Both ends belong to the range, also if they are whole numbers of units.
inline RawLimits raw_limits(double min_range_m, double max_range_m, double unit_m) {
  const double lowest = std::ceil(min_range_m / unit_m - 1e-6);
  const double highest = std::floor(max_range_m / unit_m + 1e-6);
  RawLimits limits;
  limits.lowest = static_cast<std::uint32_t>(std::clamp(lowest, 1.0, 65536.0));
  const double span = std::min(highest, 65535.0) - limits.lowest;
  // Empty range: no raw distance is that large.
  if (span < 0.0) limits.lowest = 65536;
  limits.span = static_cast<std::uint32_t>(std::max(span, 0.0));
  return limits;
}

}  // namespace zloam::driver
