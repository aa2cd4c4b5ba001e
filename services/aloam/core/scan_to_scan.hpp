#pragma once
// A-LOAM's odometry: the motion of the lidar from sweep to sweep.
//
// Each sharp point against a line through two less sharp points of the sweep before: the nearest
// within 5 m, and the nearest to the sharp point on one of the two rings above or below it. Each
// flat point against a plane through three less flat points: the nearest, the nearest on its ring
// or on the side of it, and the nearest on the other side, within two rings. Two rounds of matching
// and solving; the motion found for the sweep before is the start.
//
// As released a sweep is taken as rigid: its pose is that of its middle. With `deskew` a point
// moves by the share of the motion that its measured time says, and all that is handed on, the
// target of the next sweep too, holds for the sweep's middle. A-LOAM's DISTORTION 1 counts the
// share from the sweep's begin and leaves the target as it was recorded. Counted from the begin to
// the end, an error of one step comes back in the next with the other sign, and may grow: about the
// middle it moves the points by nothing in the mean.
//
// Frame lidar throughout. No clock, no threads: equal sweeps give equal bytes.

#include <cstdint>
#include <memory>

#include "aloam/core/motion_problem.hpp"
#include "common/geometry/point.hpp"

namespace zloam::aloam {

/// One sweep's features, frame lidar, ordered by ring. Read during the call only.
struct ScanView {
  /// of the first point
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 100000000;
  /// all points hold for the sweep's end already
  bool deskewed = false;
  PointSpan sharp, less_sharp, flat, less_flat;
};

struct ScanMotion {
  /// that instant_ns() names
  std::int64_t instant_ns = 0;
  /// at that instant
  Pose T_odom_lidar = Pose::Identity();
  /// since the sweep before, that many periods ago: more than one where sweeps are missing
  Pose step = Pose::Identity();
  double periods = 1.0;
  /// less sharp and less flat points at that instant, frame lidar; time_ns is each point's own
  PointVector edges, planes;
  std::uint32_t lines = 0, surfaces = 0;
  std::uint32_t iterations = 0;
  double residual_m = 0.0;
  /// false: the first sweep, or one without a match: the motion is the one before
  bool matched = false;
};

/// Whole number of periods between two sweeps' instants: 1 if none is missing.
double periods_between(std::int64_t before_ns, std::int64_t instant_ns, std::uint32_t period_ns);

class ScanToScan {
 public:
  explicit ScanToScan(bool deskew);
  ~ScanToScan();
  ScanToScan(ScanToScan&&) noexcept;
  ScanToScan& operator=(ScanToScan&&) noexcept;

  ScanMotion process(const ScanView& scan);
  /// Of a sweep's pose and clouds, after its first point.
  static std::uint32_t instant_ns(const ScanView& scan);
  /// The next sweep follows the one that had this result.
  void restore(const ScanMotion& last);
  /// The next sweep is a first one.
  void reset();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::aloam
