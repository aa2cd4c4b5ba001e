#pragma once
// Odometry: the motion of base_link from sweep to sweep, and the clouds for mapping at one instant.
//
// Each sweep's own motion is estimated together with its distortion: a point measured at time t is
// moved by the sweep's constant twist, inside the iteration (motion_solver.hpp). The begin is
// softly tied to the end of the sweep before. The target is planes of the last few sweeps
// (window_map.hpp). Results hold for the sweep's end. odom is base_link at the first sweep's end.
//
// No clock, no threads, no random numbers: the same sweeps give the same bytes.

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "odometry/config.hpp"
#include "odometry/degeneracy.hpp"
#include "odometry/inertial_filter.hpp"

namespace zloam::odometry {

/// The features of one sweep, frame lidar, each point at its own time. Spans are read during the
/// call only.
struct FeatureSweep {
  std::uint64_t sweep = 0;
  /// time of the sweep's first point, ns since the Unix epoch
  std::int64_t stamp_ns = 0;
  /// measured time of one revolution, ns; less than a millisecond counts as one
  std::uint32_t period_ns = 100000000;
  /// true when the source moved all points to the sweep's end already
  bool deskewed = false;
  /// number of consecutive sweeps that together cover what another lidar covers in one
  std::uint32_t slices = 1;
  double range_noise_m = 0.02;
  PointSpan less_sharp, less_flat;
  /// IMU readings, some of them beyond both ends; empty: there are none
  ImuSpan imu = {};
};

struct OdometryDiagnostics {
  std::uint32_t iterations = 0;
  std::uint32_t planes = 0;
  /// rms of the residuals after the last iteration, robustly weighted, m
  double residual_m = 0.0;
  /// error of the prediction of this sweep's end
  double prediction_error_m = 0.0;
  double prediction_error_rad = 0.0;
  /// Whether the IMU predicted the motion, and the number of wrong predictions, reduced by correct
  /// ones.
  bool imu_used = false;
  std::uint32_t imu_contradictions = 0;
  /// whether its readings cover the sweep (a deskewed one needs none)
  bool imu_covers = false;
};

struct OdometryResult {
  std::uint64_t sweep = 0;
  std::uint64_t prev_sweep = 0;
  /// the instant of pose and clouds: the sweep's end, ns since the Unix epoch
  std::int64_t instant_ns = 0;
  Pose T_odom_base = Pose::Identity();
  /// body twist of base_link from the sweep's begin to its end, m/s and rad/s:
  /// p(instant) = Exp(twist * (t_point - instant)) p(t_point) up to the bend
  Vector6 twist_per_s = Vector6::Zero();
  /// change of the twist over the sweep, m and rad per sweep, as used in deskewing: after the
  /// motion of the twist one by bend (s^2 - 1/4) / 2, s in [-1/2, 1/2] from the middle
  Vector6 bend = Vector6::Zero();
  /// of the step from prev_sweep's pose, tangent at base_link
  Matrix6 covariance = Matrix6::Zero();
  /// of T_odom_base and twist_per_s together, the start of the next sweep; nothing when the sweep
  /// was not matched
  std::optional<Matrix12> state_covariance;
  /// the IMU's preintegrated motion since the sweep before; nothing: not available
  std::optional<InertialStep> inertial_step;
  /// the IMU's parameters after the sweep, the start of the next one
  std::optional<InertialState> inertia;
  /// of slices, the input of restore_slices(); empty unless the slice ends a revolution, and always
  /// in the first revolutions
  std::vector<std::uint64_t> slice_state;
  /// cost of the residuals per point that was looked up; 0: the matching did not converge
  double fit = 0.0;
  Degeneracy degeneracy;
  /// less_sharp and less_flat, frame base_link at the instant; time_ns is still each point's own
  PointVector edges;
  PointVector planes;
  OdometryDiagnostics diagnostics;
  Health health = Health::kOk;
  /// of slices: how the platform moved since the slice before is unknown, so that T_odom_base is in
  /// a new frame, which begins with this slice
  bool new_frame = false;
};

/// The part of a sweep's result that restore() needs to continue from it.
struct CommittedSweep {
  std::uint64_t sweep = 0;
  std::uint64_t prev_sweep = 0;
  std::int64_t instant_ns = 0;
  std::uint32_t period_ns = 0;
  Pose T_odom_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Health health = Health::kOk;
  std::optional<Matrix12> state_covariance;
  double fit = 0.0;
  PointSpan planes;
  std::optional<InertialState> inertia = {};
};

/// The features of an earlier slice, by its number; nothing: they are gone. The result is read
/// before the next call.
using SliceAt = std::function<std::optional<FeatureSweep>(std::uint64_t sweep)>;

class Odometry {
 public:
  Odometry(const OdometryConfig& config, const Pose& T_base_lidar,
           const Pose& T_base_imu = Pose::Identity());
  ~Odometry();
  Odometry(Odometry&&) noexcept;
  Odometry& operator=(Odometry&&) noexcept;

  /// Moves on by one sweep. Sweeps come in ascending order; numbers and times may have gaps. Points
  /// that are not finite are ignored. Never throws on bad data: the pose is then the prediction,
  /// and the health says why.
  OdometryResult process(const FeatureSweep& sweep);

  /// The first half of process(): all but the clouds. The pose can be used while complete() works,
  /// which takes about as long.
  OdometryResult locate(const FeatureSweep& sweep);
  /// The second half, with the sweep and the result of locate(): fills in the clouds, which the
  /// next sweep is matched with. Must follow before the next sweep.
  void complete(const FeatureSweep& sweep, OdometryResult& result);

  /// Restores the state from the results of the last sweeps, ascending, as another instance
  /// published them; with restore_depth() of them the continuation is bit-exact, if all of these
  /// were matched. A sweep that is its own prev_sweep begins a frame: those before it do not count.
  void restore(std::span<const CommittedSweep> sweeps);

  /// The same for slices, whose results do not hold the whole state: from the slice_state of one
  /// slice and the features of those before. False, and reset: too few features, or another
  /// program's state.
  bool restore_slices(std::span<const std::uint64_t> state, const SliceAt& slice_at);

  /// From the next sweep on. What the targets were built with (config.hpp says which) stays.
  void configure(const OdometryConfig& config);

  /// Forgets everything: the next sweep is a first one.
  void reset();

  /// Number of sweeps that restore() can use.
  std::size_t restore_depth() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::odometry
