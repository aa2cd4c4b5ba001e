#pragma once
// A sweep prepared for matching: valid points in order of time slots, and the motion of each slot
// under a constant twist over the sweep.

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/containers/thinning.hpp"
#include "common/geometry/inertial_step.hpp"
#include "common/geometry/lanes.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::plane_map {

/// Motion used to deskew a cloud: p(instant) = Exp(twist * (t - instant)) * p(t), in base_link.
struct Deskewing {
  Vector6 twist_per_s = Vector6::Zero();  // m/s, rad/s
  std::uint32_t instant_ns = 0;           // after the sweep's stamp
};

/// One sweep. Points carry the time of their measurement in time_ns after stamp_ns. They are either
/// raw, in a frame whose pose in base_link is T_base_points; or, with `deskewed`, at one instant.
struct SweepInput {
  PointSpan points;
  PointSpan more_points;  // further points of the same sweep, in other memory
  Pose T_base_points = Pose::Identity();
  std::int64_t stamp_ns = 0;
  std::uint32_t period_ns = 100'000'000;
  std::optional<Deskewing> deskewed;
  /// The IMU's motion since the sweep before, which must directly precede this one.
  std::optional<InertialStep> inertial;

  std::size_t size() const { return points.size() + more_points.size(); }
};

/// The sweep is cut into slots of equal time; points move by the motion at the nearest of the
/// kSlots + 1 slot boundaries: 0.1 ms or 2 mm at 20 m/s for a sweep of 0.1 s.
constexpr int kSlots = 1024;

/// Slot i as a fraction of the sweep about its middle, in [-1/2, 1/2].
constexpr double slot_fraction(int slot) { return static_cast<double>(slot) / kSlots - 0.5; }

struct SlotPoint {
  float x, y, z;
  std::uint16_t slot;
  std::uint16_t ring;
};

/// One motion for each slot boundary.
using SlotMotions = std::vector<MotionLanes>;

/// Selects the valid points of a sweep (finite, at least min_range_m from the frame's origin) among
/// those that the thinning keeps, in slot order and in the given order within a slot. Replaces the
/// content of `out`.
void take_points(const SweepInput& sweep, double min_range_m, const Thinning& thinning,
                 std::vector<SlotPoint>& out);

/// The selected points of a sweep and their motion.
class SweepPoints {
 public:
  SweepPoints() = default;
  SweepPoints(const SweepInput& sweep, double min_range_m) { set(sweep, min_range_m); }
  /// Takes another sweep and reuses the memory of the one before: megabytes that the kernel would
  /// otherwise clear each time.
  void set(const SweepInput& sweep, double min_range_m, const Thinning& thinning = {});

  const std::vector<SlotPoint>& points() const { return points_; }

  /// Motions that transform the points as given to the axes of T_mid's parent frame, relative to
  /// T_mid's translation. base_link moves with T_mid * Exp(s twist + s^2 bend / 2), twist and bend
  /// over the whole sweep. Earlier deskewing is undone.
  SlotMotions motions(const Eigen::Matrix3d& rotation, const Vector6& twist,
                      const Vector6& bend = Vector6::Zero()) const;

 private:
  std::vector<SlotPoint> points_;
  Pose T_base_points_ = Pose::Identity();
  std::vector<Pose> undo_;  // per slot; empty for raw points
};

}  // namespace zloam::plane_map
