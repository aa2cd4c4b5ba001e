#pragma once
// Whether a stored scan is plausible.

#include <span>
#include <string>

#include "driver/sweep/decoded_sweep.hpp"

namespace zloam::driver {

/// More beams than any lidar has: then the points are not in the expected order.
inline constexpr int kMostRings = 128;
/// Fewer returns than this are not judged.
inline constexpr std::size_t kJudgedReturns = 100;

/// Why no lidar can have produced this scan of 4 floats per point, ring by ring; empty: one can.
std::string implausible(std::span<const float> xyzi);

/// The same for a scan with rings and times.
std::string implausible(const DecodedSweep& sweep);

}  // namespace zloam::driver
