#pragma once
// Encodes ROS 2 messages as CDR bytes (cdr_stream.hpp), little endian, and decodes those that the
// stages need.

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

/// Specific force and angular rate of a sensor_msgs/msg/Imu in either byte order. Empty if the
/// bytes are no such message, if a value is not finite or beyond 1e6, if the stamp is negative (all
/// readings of a message with such a one would be refused), or if the message lacks the
/// acceleration or the rate (their covariance then begins with -1).
std::optional<ImuReading> decode_imu(std::span<const std::uint8_t> bytes);

/// The pose that RViz's "2D Pose Estimate" publishes.
struct PlaceMessage {
  std::string frame;
  double x_m = 0.0;
  double y_m = 0.0;
  double yaw_rad = 0.0;
};

/// Decodes a geometry_msgs/msg/PoseWithCovarianceStamped in either byte order. Empty if the bytes
/// are no such message, x or y is not finite, the quaternion's norm is not 1, or the name of the
/// frame is longer than any.
std::optional<PlaceMessage> decode_place(std::span<const std::uint8_t> bytes);

}  // namespace zloam::ros
