#pragma once
// Moves the points of a sweep to one instant under a constant body twist, or one that changes.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "common/geometry/lanes.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam {

/// Offset of a motion whose rate changes by one over a sweep from the steady motion between the
/// same ends, at the fraction s in [-1/2, 1/2] of the sweep.
inline double bent_at(double s) { return 0.5 * (s * s - 0.25); }

/// Motions at even steps from a sweep's first to its last moment, the twist changing by `bend` (m
/// and rad per sweep) over it; the first and the last stay unchanged.
void bend_motions(const Vector6& bend, std::vector<Pose>& motions);

/// Table of motions p(instant) = Exp(twist * (t - instant)) * p(t) over one sweep. A point is moved
/// by the nearest of kSteps + 1 entries: an error of at most half a step, 1 mm at 20 m/s in a 0.1 s
/// sweep and 0.16 mrad at 190 deg/s, far below a lidar's range noise and a hundred times cheaper
/// than one exponential per point.
class DeskewTable {
 public:
  static constexpr int kSteps = 1024;

  /// twist: body twist in m/s and rad/s; period_ns: time span covered by the points, instant_ns
  /// after the sweep's first point. Times outside [0, period_ns] use the nearest end.
  DeskewTable(const Vector6& twist_per_s, std::uint32_t period_ns, std::uint32_t instant_ns);

  /// A table with the same ends and a twist that changes by `bend` over the period.
  DeskewTable bent(const Vector6& bend) const;

  /// A table for points that `before`, a table of the same sweep, has already moved: it moves them
  /// to where this table would have moved the original points.
  DeskewTable in_place_of(const DeskewTable& before) const;

  /// Entry of a point measured time_ns after the sweep's start: the nearest.
  std::size_t step_at(std::uint32_t time_ns) const {
    // Truncated after adding a half: avoids a call for each point.
    const double above = time_ns * step_per_ns_ + 0.5;
    return std::min<std::size_t>(static_cast<std::size_t>(above), kSteps);
  }
  /// Motion that carries a point measured time_ns after the sweep's start to the instant.
  const Pose& motion_at(std::uint32_t time_ns) const { return motions_[step_at(time_ns)]; }

  /// All entries, for points of a frame whose pose in the moving one is given.
  std::vector<MotionLanes> lanes(const Pose& T_moving_points) const;

 private:
  double step_per_ns_;
  std::vector<Pose> motions_;
};

/// Re-projects all points; only x, y, z change.
PointVector deskewed(PointSpan points, const DeskewTable& table);

}  // namespace zloam
