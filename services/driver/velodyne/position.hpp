#pragma once
// Position (telemetry) packets: 512 bytes of UDP payload with the time, the state of the
// pulse-per-second input, the receiver's last NMEA sentence and, on an HDL-32E, inertial readings
// (VLP-16 manual 63-9243 p. 60; inertial words as the HDL-32E manual has them).

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "driver/decoder/nmea.hpp"

namespace zloam::driver::velodyne {

/// One of three sets of a gyro and a two-axis accelerometer, in the sensor's own arrangement.
struct InertialSet {
  double gyro_dps = 0.0;
  double temperature_c = 0.0;
  double accel_x_g = 0.0;
  double accel_y_g = 0.0;
};

struct InertialPositionPacket : PositionPacket {
  std::array<InertialSet, 3> inertial;
};

/// Nothing when the payload is not 512 bytes.
std::optional<InertialPositionPacket> parse_position(std::span<const std::uint8_t> payload);

}  // namespace zloam::driver::velodyne
