#pragma once
// Whether a stored scan can be what it is taken for.

#include <span>
#include <string>

#include "driver/sweep/decoded_sweep.hpp"

namespace zloam::driver {

/// More beams than any lidar has: then the points are not in the order that they are read in.
inline constexpr int kMostRings = 128;
/// Fewer returns than this say nothing.
inline constexpr std::size_t kJudgedReturns = 100;

/// Why no lidar can have seen this scan of 4 floats a point, ring by ring; empty: it can.
std::string implausible(std::span<const float> xyzi);

/// The same of a scan with rings and times.
std::string implausible(const DecodedSweep& sweep);

}  // namespace zloam::driver
