#pragma once
// A-LOAM's scan registration: the feature points of each ring by a fixed threshold of curvature.
//
// c_i = |sum of p_j - p_i over the five points before and after|^2, not divided by anything. Each
// ring, less five points at either end, is cut into 6 parts; in each at most 2 sharp and 20 less
// sharp points (c > 0.1, largest first) and 4 flat ones (c < 0.1, smallest first). A pick keeps its
// 5 neighbours on either side from being picked, as far as they lie within 0.22 m of each other.
// What is no less sharp point is averaged ring by ring in voxels of 0.2 m: the less flat points.
//
// Differences, as the messages have what A-LOAM has to guess: ring and time are the sensor's own;
// of two returns of a firing the stronger one is taken, and the last one where there is no other.

#include <cstdint>
#include <limits>
#include <string>

#include "common/geometry/point.hpp"

namespace zloam::aloam {

struct ScanFeatures {
  /// frame lidar, each at its own time, ordered by ring; sharp is part of less_sharp
  PointVector sharp, less_sharp, flat, less_flat;
  /// not finite, too near, outside the elevations, or the weaker of two returns
  std::uint32_t rejected = 0;
};

/// Points outside are left out.
struct Elevations {
  double least_deg = -std::numeric_limits<double>::infinity();
  double greatest_deg = std::numeric_limits<double>::infinity();
};

/// `rings`: what lies in a ring not below it is left out. `one_return`: each firing has one return,
/// which is taken, whatever its type.
ScanFeatures extract_features(PointSpan sweep, double min_range_m,
                              const Elevations& elevations = {},
                              std::uint32_t rings = std::numeric_limits<std::uint16_t>::max(),
                              bool one_return = false);

/// Why sweeps of a sensor with so many rings have no features; empty: they have. `slices`: so many
/// sweeps show all around.
std::string rings_error(std::uint32_t rings, std::uint32_t slices);
/// Why sweeps of which so many show all around can't be matched with one another; empty: they can.
std::string slices_error(std::uint32_t slices);

}  // namespace zloam::aloam
