#pragma once
// A sensor's metadata: its beams, and the format of its packets. As the sensor's HTTP API gives
// them at /api/v1/sensor/metadata, and as the maker's tools store them beside recordings, in the
// nested layout of firmware 2.4 and later or the flat one before it.

#include <Eigen/Geometry>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "driver/ouster/profile.hpp"

namespace zloam::driver::ouster {

/// Which return of two comes first in a pixel.
enum class ReturnOrder : std::uint8_t { kStrongestFirst, kFarthestFirst, kNearestFirst };

struct Metadata {
  std::string model;
  std::uint64_t serial = 0;
  /// of the sensor's start, 0: not given
  std::uint32_t initialization_id = 0;

  const Profile* profile = nullptr;
  /// header of the functional safety profile
  bool fusa_header = false;
  int pixels_per_column = 0;
  int columns_per_frame = 0;
  int columns_per_packet = 0;
  /// first and last column within the azimuth window; the first may be greater
  int first_column = 0;
  int last_column = 0;
  double frames_per_s = 10.0;
  ReturnOrder return_order = ReturnOrder::kStrongestFirst;

  /// by pixel, from the top row down
  std::vector<double> altitude_deg;
  std::vector<double> azimuth_deg;
  /// the beams' origin in the frame that rotates with the rotor: before the sensor's axis, above it
  double beam_origin_x_m = 0.0;
  double beam_origin_z_m = 0.0;
  Eigen::Isometry3d T_sensor_lidar = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_sensor_imu = Eigen::Isometry3d::Identity();

  /// readings in a packet of the IMU's newer profile; 0: the older one, of 48 bytes
  int imu_readings_per_packet = 0;

  const Framing& framing() const {
    return profile->name == kLegacy ? kLegacyFraming : kConfigurableFraming;
  }
  std::size_t column_bytes() const;
  std::size_t packet_bytes() const;
  std::size_t imu_packet_bytes() const;
  double column_ns() const { return 1e9 / (frames_per_s * columns_per_frame); }
  /// within the azimuth window
  bool sees(int column) const;
};

/// The metadata, or why they can't be used: a sentence.
std::variant<Metadata, std::string> parse_metadata(const std::string& text);

}  // namespace zloam::driver::ouster
