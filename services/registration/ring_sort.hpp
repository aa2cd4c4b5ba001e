#pragma once
// First step of registration: selects the usable points and sorts them by ring and time.

#include <cstdint>
#include <vector>

#include "registration/registration.hpp"

namespace zloam::registration {

/// The usable points of a sweep, ring after ring, in time order within a ring.
struct RingSorted {
  PointVector points;
  std::vector<float> range_m;  ///< parallel to points
  /// points of ring r: [ring_begin[r], ring_begin[r + 1])
  std::vector<std::uint32_t> ring_begin;
  /// usual time between two firings of one ring, ns; 0 when the points carry no times
  std::uint32_t firing_interval_ns = 0;
  /// usual angle between two firings of one ring, rad
  double step_rad = 0.0;
};

/// Drops unusable points into result.rejected and sorts the rest. Points of a sweep without rings
/// get their elevation, in steps of a beam's width, as ring.
RingSorted sort_by_ring(PointSpan sweep, const SweepInfo& info, const RegistrationConfig& config,
                        RegistrationResult& result);

/// True when points i and i + 1 of the same ring come from successive firings.
bool adjacent(const RingSorted& sorted, std::uint32_t i);

/// Firings from point i to point i + 1 of the same ring, 1 for successive ones; infinite when
/// unknown.
double steps_after(const RingSorted& sorted, std::uint32_t i);

}  // namespace zloam::registration
