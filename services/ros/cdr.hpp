#pragma once
// ROS 2's messages as bytes (cdr_stream.hpp), little endian.

#include <cstdint>
#include <optional>
#include <span>
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

}  // namespace zloam::ros
