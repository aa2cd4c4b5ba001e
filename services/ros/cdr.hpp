#pragma once
// ROS 2's messages as bytes (cdr_stream.hpp), little endian.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "ros/messages.hpp"

namespace zloam::ros {

using Cdr = std::vector<std::uint8_t>;

Cdr encode(const OdometryMessage& message);
Cdr encode(const PoseMessage& message);
Cdr encode(const std::vector<TransformMessage>& message);
Cdr encode(const PathMessage& message);
Cdr encode(const CloudMessage& message);
Cdr encode(const DiagnosticsMessage& message);

/// A sensor_msgs/msg/Imu, of either byte order: specific force and rate. Empty: it is none, or it
/// says that it has no acceleration or rate (its covariance begins with -1), or holds what is no
/// number.
std::optional<ImuReading> decode_imu(std::span<const std::uint8_t> bytes);

/// What RViz's "2D Pose Estimate" says.
struct PlaceMessage {
  std::string frame;
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;
};

/// A geometry_msgs/msg/PoseWithCovarianceStamped, of either byte order. Empty: it is none, or holds
/// what is no number, or no rotation.
std::optional<PlaceMessage> decode_place(std::span<const std::uint8_t> bytes);

}  // namespace zloam::ros
