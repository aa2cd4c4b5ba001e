#pragma once
// Feature extraction from one sweep, after LOAM (Zhang and Singh, RSS 2014, section V-A) and
// A-LOAM: sharp and flat points of each ring by curvature. Two things differ from the released
// code: the curvature is tested against the sensor's range noise instead of a fixed number, and its
// component along the surface is ignored, so that neither noise nor an oblique plane makes an edge.
//
// A sweep without rings (a rosette, any cloud) has no lines along which a curvature could be
// computed: all its points are less flat, none is an edge.
//
// A pure function of its arguments: no state, no clock, no threads. Any input is accepted.

#include <cstdint>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/point.hpp"
#include "registration/config.hpp"

namespace zloam::registration {

/// Why a point was dropped; numbers as in schemas/rejected.fbs.
enum class RejectReason : std::uint8_t {
  kNotFinite = 0,
  kTooNear = 1,
  kTooFar = 2,
  kNearParallel = 3,
  kOccluded = 4,
  kOtherReturn = 5,
};
inline constexpr int kRejectReasons = 6;

struct SweepInfo {
  /// measured time of one revolution, ns
  std::uint32_t period_ns = 100000000;
  /// rings of the sensor; a higher ring in the data extends it. 0: the points have none
  std::uint16_t rings = 16;
  /// each firing has one return; it is used, whatever its type
  bool one_return = false;
};

struct RegistrationDiagnostics {
  std::uint32_t points_in = 0;
  std::uint32_t points_used = 0;
  /// by RejectReason; unreliable points are counted even when less_flat keeps them
  std::uint32_t rejected[kRejectReasons] = {};
  std::uint32_t edge_candidates = 0;
  /// typical angle between two firings of a ring, rad
  double step_rad = 0.0;
  /// range noise estimated from the smooth stretches of this sweep, m; 0 when there are too few
  double measured_noise_m = 0.0;
};

/// Feature clouds, frame lidar, each point at its own time, ordered by (ring, time).
struct RegistrationResult {
  PointVector sharp;
  PointVector less_sharp;  ///< contains sharp
  PointVector flat;
  PointVector less_flat;  ///< all points that are no edges; contains flat before the voxel filter
  PointVector rejected;
  std::vector<RejectReason> reasons;  ///< parallel to rejected
  RegistrationDiagnostics diagnostics;
  /// kOk, kEmpty or kTooFewPoints
  Health health = Health::kOk;
};

/// Features of one sweep. sweep: points in frame lidar, in time order.
RegistrationResult extract_features(PointSpan sweep, const SweepInfo& info,
                                    const RegistrationConfig& config);

}  // namespace zloam::registration
