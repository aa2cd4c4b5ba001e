#pragma once
// What ROS's conventions (REP 105) make of the stages' poses: odom -> base_link with a covariance
// that grows along the way, map -> odom as the map corrects it.

#include <cstdint>
#include <deque>
#include <utility>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::ros {

/// One message of the odometry.
struct OdometryStep {
  std::uint64_t run = 0;
  std::uint64_t sweep = 0;
  std::uint32_t epoch = 0;
  std::int64_t instant_ns = 0;
  Pose T_odom_base = Pose::Identity();
  /// of the step since the pose before, tangent at base_link
  Matrix6 step_covariance = Matrix6::Zero();
};

/// One message of the fused pose, or of mapping.
struct MapStep {
  std::uint64_t run = 0;
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
};

/// Covariance of a pose T_frame_base, given in the tangent at base_link, as ROS has it: of the
/// position in the frame, and of rotations about the frame's axes.
Matrix6 about_frame_axes(const Pose& T_frame_base, const Matrix6& tangent_covariance);

class PoseTree {
 public:
  /// Covariance of T_odom_base in the odom frame (about_frame_axes), and of the twist in
  /// (m/s, rad/s)^2: the first of a frame is exact, and each step adds its own.
  struct Uncertainty {
    Matrix6 pose = Matrix6::Zero();
    Matrix6 twist = Matrix6::Zero();
  };
  Uncertainty add(const OdometryStep& step);

  /// T_map_odom and the instant it holds for.
  struct Correction {
    std::int64_t instant_ns = 0;
    Pose T_map_odom = Pose::Identity();
  };
  /// A sweep's pose in the map. It comes on another way than its odometry, before or after it.
  void add(const MapStep& step);
  /// What both of a sweep have said since it was asked last, in the order of time.
  std::vector<Correction> take_corrections() { return std::exchange(corrections_, {}); }

 private:
  void correct(const OdometryStep& odometry, const MapStep& map);

  std::deque<OdometryStep> steps_;
  /// whose odometry has not come
  std::deque<MapStep> waiting_;
  std::vector<Correction> corrections_;
  Matrix6 covariance_ = Matrix6::Zero();
};

}  // namespace zloam::ros
