#pragma once
// Fuses odometry (every sweep) with mapping's corrections (some sweeps, later): LOAM's transform
// maintenance. T_map_base(n) = T_map_odom(k) * T_odom_base(n).
//
// Choice of k. Replay: the greatest multiple of mapping_every at or below n - correction_delay; the
// pose waits for it, so that the result does not depend on which stage was faster
// (docs/protocol.md, section 8); before the first one, identity. Live: the newest correction of the
// same odometry epoch that is not of a later sweep (later ones exist while old poses are caught up
// with), else the next later one; nothing waits. Until an epoch has a correction, the pose is
// predicted from the last one with the odometry's own motion (Health::kBridging).
//
// The odometry's steps since that correction are fused with the motion between the last mapped
// poses (step_fusion.hpp): where the odometry is degenerate, the map's motion leads.
//
// Nothing is smoothed: the whole change of a correction is in the pose, and is marked as a jump
// when large.

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "common/geometry/health.hpp"
#include "common/geometry/se3.hpp"
#include "integration/config.hpp"
#include "integration/odometry_drift.hpp"
#include "integration/own_motion.hpp"
#include "integration/step_fusion.hpp"

namespace zloam::integration {

struct OdometryPose {
  std::uint64_t sweep = 0;
  /// ns since the Unix epoch
  std::int64_t instant_ns = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_odom_base = Pose::Identity();
  /// body frame, m/s and rad/s
  Vector6 twist_per_s = Vector6::Zero();
  /// of the step from the pose before, tangent at base_link
  Matrix6 step_covariance = Matrix6::Zero();
  Health health = Health::kOk;
  Weak weak{};
  /// the source is paced: the pose waits for its correction
  bool replay = false;

  template <class Bits>
  void each(Bits& bits) {
    bits(sweep, instant_ns, odom_epoch, T_odom_base, twist_per_s, step_covariance, health, weak,
         replay);
  }
};

struct Correction {
  std::uint64_t sweep = 0;
  std::uint64_t map_id = 0;
  std::uint32_t odom_epoch = 0;
  Pose T_map_odom = Pose::Identity();
  /// of T_map_base at that sweep, tangent at base_link
  Matrix6 covariance = Matrix6::Zero();
  Health health = Health::kOk;
  Weak weak{};

  template <class Bits>
  void each(Bits& bits) {
    bits(sweep, map_id, odom_epoch, T_map_odom, covariance, health, weak);
  }
};

struct FusedPose {
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 covariance = Matrix6::Zero();
  std::uint64_t correction_sweep = 0;
  bool has_correction = false;
  bool jump = false;
  Health health = Health::kOk;
  Weak weak{};
  /// Odometry and map have come apart by drift_m over the last way_m.
  double odometry_drift_m = 0.0;
  double odometry_way_m = 0.0;
  /// by more than the drift limit over ten metres and the map's covariances
  bool odometry_drifts = false;

  template <class Bits>
  void each(Bits& bits) {
    bits(sweep, instant_ns, T_map_base, twist_per_s, covariance, correction_sweep, has_correction,
         jump, health, weak, odometry_drift_m, odometry_way_m, odometry_drifts);
  }
};

/// A correction that was used, as a pose.
struct MappedPose {
  std::uint64_t sweep = 0;
  std::uint64_t map_id = 0;
  std::uint32_t odom_epoch = 0;
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
  Pose T_odom_base = Pose::Identity();
  Matrix6 covariance = Matrix6::Zero();
  /// the map has measured it; else it is predicted, or lost
  bool located = false;

  template <class Bits>
  void each(Bits& bits) {
    bits(sweep, map_id, odom_epoch, instant_ns, T_map_base, T_odom_base, covariance, located);
  }
};

/// The correction that pose n waits for in replay; none before the first.
std::optional<std::uint64_t> scheduled_correction(std::uint64_t sweep,
                                                  const IntegrationConfig& config);

class Integrator {
 public:
  explicit Integrator(const IntegrationConfig& config);

  /// Takes poses in ascending order; one that is not above the last is ignored. Returns the poses
  /// that can be published now, ascending: none, one, or those that waited.
  std::vector<FusedPose> add(const OdometryPose& pose);
  std::vector<FusedPose> add(const Correction& correction);

  /// Poses that wait for a correction.
  std::size_t waiting() const { return waiting_.size(); }
  /// Sweep of the newest pose that was published.
  std::optional<std::uint64_t> last_sweep() const {
    return last_fused_ ? std::optional(last_fused_->sweep) : std::nullopt;
  }
  /// The correction that the first waiting pose needs.
  std::optional<std::uint64_t> awaited() const;
  void reset();

  /// A new run's sweeps begin at 0 again, in the same odometry frame.
  void new_run();
  /// Continues after a pose that another instance published.
  void restore(const OdometryPose& pose, const Pose& T_map_base);

  /// The state that later poses depend on, without the poses that wait.
  std::vector<std::uint64_t> state() const;
  /// Continues bit-exactly from the state() of another integrator. False, and empty: not valid.
  bool resume(std::span<const std::uint64_t> state);

 private:
  std::vector<FusedPose> release();
  bool can_leave(const OdometryPose& pose) const;
  /// nullptr: none
  const Correction* correction_for(const OdometryPose& pose) const;
  FusedPose fuse(const OdometryPose& pose);
  void place(const OdometryPose& pose, const Correction* correction, FusedPose& fused);
  void follow_map(const Correction& correction);
  void watch_odometry(const MappedPose& now, const Correction& correction);
  Pose step_between(const OdometryPose& from, const OdometryPose& to) const;
  /// T_map_base of the pose, by the steps from the correction's sweep; nothing when that sweep's
  /// odometry is no longer kept
  std::optional<Pose> carried_on(const OdometryPose& pose, const Correction& correction) const;
  Weak weak_of(const OdometryPose& pose, const Correction& correction) const;
  Weak judged(const OdometryPose& pose, const Correction* correction,
              const Matrix6& covariance) const;
  Health health_of(const OdometryPose& pose, const Correction* correction, const Weak& weak,
                   bool uncorrected) const;
  Matrix6 step_covariance(const OdometryPose& pose) const;
  Matrix6 covariance_after_break(const OdometryPose& pose) const;
  Matrix6 covariance_at(const OdometryPose& pose, const Correction* correction);
  Matrix6 contradiction_at(const OdometryPose& pose, const Correction* correction) const;
  bool is_measured(const OdometryPose& pose, const Correction* correction, bool uncorrected) const;
  /// measured: as is_measured()
  Matrix6 own_motion_at(const FusedPose& fused, bool measured);
  /// The map has not corrected the pose for long: the pose depends on the odometry alone.
  bool old(const OdometryPose& pose, const Correction* correction);
  void forget();
  template <class Bits>
  void each(Bits& bits) {
    bits(recent_, corrections_, mapped_, contradiction_m_, steps_, own_motion_, drift_,
         last_odometry_, last_fused_, last_T_map_odom_, first_epoch_, corrected_ns_);
  }

  IntegrationConfig config_;
  std::deque<OdometryPose> waiting_;
  std::map<std::uint64_t, Correction> corrections_;
  std::deque<OdometryPose> recent_;  // to carry a correction's covariance forward
  std::optional<std::uint64_t> newest_pose_;
  std::optional<MappedPose> mapped_;
  /// of mapped_: StepFusion::contradiction_m()
  Eigen::Vector3d contradiction_m_ = Eigen::Vector3d::Zero();
  StepFusion steps_;
  OwnMotion own_motion_;
  OdometryDrift drift_;
  std::optional<OdometryPose> last_odometry_;
  std::optional<FusedPose> last_fused_;
  std::optional<Pose> last_T_map_odom_;
  std::optional<std::uint32_t> first_epoch_;
  /// of the newest sweep that the map has corrected
  std::optional<std::int64_t> corrected_ns_;
};

}  // namespace zloam::integration
