#pragma once
// Position (telemetry) packets: 512 bytes of UDP payload with the time, the state of the
// pulse-per-second input, the receiver's last NMEA sentence and, on an HDL-32E, inertial readings
// (VLP-16 manual 63-9243 p. 60; inertial words as the HDL-32E manual has them).

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace zloam::driver {

/// Values of the message's enumeration.
enum class Pps : std::uint8_t { kAbsent = 0, kSynchronising = 1, kLocked = 2, kError = 3 };

/// One of three sets of a gyro and a two-axis accelerometer, in the sensor's own arrangement.
struct InertialSet {
  double gyro_dps = 0.0;
  double temperature_c = 0.0;
  double accel_x_g = 0.0;
  double accel_y_g = 0.0;
};

struct PositionPacket {
  std::uint32_t toh_us = 0;
  Pps pps = Pps::kAbsent;
  std::array<InertialSet, 3> inertial;
  /// without padding and line end; empty when there is no receiver
  std::string nmea;
};

/// Nothing when the payload is not 512 bytes.
std::optional<PositionPacket> parse_position(std::span<const std::uint8_t> payload);

struct NmeaFix {
  /// ns since the Unix epoch; 0 without a date
  std::int64_t utc_ns = 0;
  double latitude_deg = 0.0;
  double longitude_deg = 0.0;
  /// the receiver says so (A)
  bool valid = false;
};

/// A $..RMC sentence. Nothing for other sentences, a wrong checksum, or fields that are no numbers.
std::optional<NmeaFix> parse_rmc(std::string_view sentence);

/// Whether a sensor's time of the hour is that of its receiver's sentence to 2 s (a sentence tells
/// of the second before). True when the sentence has no date.
bool agrees_with_utc(std::uint32_t toh_us, std::int64_t utc_ns);

}  // namespace zloam::driver
