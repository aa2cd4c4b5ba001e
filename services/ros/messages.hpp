#pragma once
// ROS 2 messages as plain structs, after the definitions of common_interfaces (geometry_msgs,
// nav_msgs, sensor_msgs, tf2_msgs, diagnostic_msgs). Times are ns since the Unix epoch.

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "common/geometry/imu_reading.hpp"
#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::ros {

struct Stamped {
  std::int64_t stamp_ns = 0;
  std::string frame;
};

struct OdometryMessage {
  Stamped header;
  std::string child_frame;
  Pose T_frame_child = Pose::Identity();
  /// order, as in ROS: x y z, then rotations about the axes of the header's frame
  Matrix6 pose_covariance = Matrix6::Zero();
  /// m/s and rad/s in the child's frame
  Vector6 twist = Vector6::Zero();
  Matrix6 twist_covariance = Matrix6::Zero();
};

struct PoseMessage {
  Stamped header;
  Pose T_frame_base = Pose::Identity();
  Matrix6 covariance = Matrix6::Zero();
};

struct TransformMessage {
  Stamped header;
  std::string child_frame;
  Pose T_frame_child = Pose::Identity();
};

struct PathMessage {
  Stamped header;
  /// (stamp, pose), in ascending time
  std::vector<std::pair<std::int64_t, Pose>> poses;
};

struct CloudMessage {
  Stamped header;
  /// x, y, z, intensity as floats
  std::span<const MapPoint> points;
};

/// Values as in diagnostic_msgs.
enum class DiagnosticLevel : std::uint8_t { kOk = 0, kWarning = 1, kError = 2, kStale = 3 };

struct Diagnostic {
  DiagnosticLevel level = DiagnosticLevel::kOk;
  std::string name;
  std::string message;
  std::string hardware;
  std::vector<std::pair<std::string, std::string>> values;
};

struct DiagnosticsMessage {
  Stamped header;
  std::vector<Diagnostic> all;
};

}  // namespace zloam::ros
