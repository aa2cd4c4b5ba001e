#pragma once
// Converts the stages' poses to ROS's frames (REP 105): odom -> base_link with a covariance that
// accumulates along the way, and map -> odom from mapping's corrections.

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
  /// covariance of the motion since the previous pose, tangent at base_link
  Matrix6 step_covariance = Matrix6::Zero();
};

/// One message of the fused pose, or of mapping.
struct MapStep {
  std::uint64_t run = 0;
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  Pose T_map_base = Pose::Identity();
};

/// Converts the covariance of T_frame_base from the tangent at base_link to ROS's convention:
/// position in the frame, and rotations about the frame's axes.
Matrix6 about_frame_axes(const Pose& T_frame_base, const Matrix6& tangent_covariance);

class PoseTree {
 public:
  /// Covariance of T_odom_base in the odom frame (about_frame_axes), and of the twist in
  /// (m/s, rad/s)^2. The first pose of an odom frame is exact; each step adds its covariance, also
  /// one that comes late, because its message was lost at first. A frame is its epoch: it may
  /// continue in another run.
  struct Uncertainty {
    Matrix6 pose = Matrix6::Zero();
    Matrix6 twist = Matrix6::Zero();
  };
  Uncertainty add(const OdometryStep& step);

  /// T_map_odom and the instant for which it is valid.
  struct Correction {
    std::int64_t instant_ns = 0;
    Pose T_map_odom = Pose::Identity();
  };
  /// Adds a sweep's pose in the map. It arrives on another key than the sweep's odometry, and so
  /// before or after it.
  void add(const MapStep& step);
  /// The corrections of all sweeps whose odometry and map pose are both known, since the last call,
  /// in the order in which they were completed.
  std::vector<Correction> take_corrections() { return std::exchange(corrections_, {}); }

 private:
  using Steps = std::deque<OdometryStep>;

  void correct(const OdometryStep& odometry, const MapStep& map);
  /// The newest of the same frame that is older.
  Steps::reverse_iterator last_before(const OdometryStep& step);
  Uncertainty go_on(const OdometryStep& step);
  Uncertainty add_late(const OdometryStep& step);
  void join_waiting(const OdometryStep& step);

  Steps steps_;
  /// map poses whose odometry has not arrived yet
  std::deque<MapStep> waiting_;
  std::vector<Correction> corrections_;
  Matrix6 covariance_ = Matrix6::Zero();
};

}  // namespace zloam::ros
