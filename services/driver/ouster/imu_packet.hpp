#pragma once
// IMU packets: one reading in 48 bytes (LEGACY), or several with the receiver's NMEA sentence
// (ACCEL32_GYRO32_NMEA, firmware 3.2 and later).

#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/imu_reading.hpp"
#include "driver/ouster/metadata.hpp"

namespace zloam::driver::ouster {

/// Whether a packet is an IMU packet. The legacy one has the length of NTP's and no mark: its two
/// times must be close, and its numbers physically plausible.
bool is_imu_packet(std::span<const std::uint8_t> payload, const Metadata& metadata);

/// Readings in the axes of the sensor's frame; stamps: ns since the top of the sensor's hour. Empty
/// for another packet.
std::vector<ImuReading> parse_imu(std::span<const std::uint8_t> payload, const Metadata& metadata);

}  // namespace zloam::driver::ouster
