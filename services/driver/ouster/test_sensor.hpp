#pragma once
// A sensor's description and packets made by hand, for tests.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <string>
#include <variant>
#include <vector>

#include "driver/ouster/decoder.hpp"

namespace zloam::driver::ouster::test {

using Bytes = std::vector<std::uint8_t>;

inline std::string list_of(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) text += (text.empty() ? "[" : ", ") + std::to_string(value);
  return text + "]";
}

/// Metadata of a sensor with 16 lasers, in the nested layout.
struct Description {
  std::string profile = "RNG19_RFL8_SIG16_NIR16";
  std::string mode = "1024x10";
  int pixels = 16;
  int columns = 1024;
  std::string window = "[0, 1023]";
  std::string return_order = "STRONGEST_TO_WEAKEST";
  std::string imu = R"("udp_profile_imu": "LEGACY")";
  std::string more;

  static double altitude_deg(int pixel) { return 15.0 - 2.0 * pixel; }
  static double azimuth_deg(int pixel) { return pixel % 2 == 0 ? 3.0 : -1.0; }

  std::string text() const {
    std::vector<double> altitudes, azimuths;
    for (int p = 0; p < pixels; ++p) {
      altitudes.push_back(altitude_deg(p));
      azimuths.push_back(azimuth_deg(p));
    }
    return R"({"sensor_info": {"prod_line": "OS-1-16", "prod_sn": "122201000998",)"
           R"( "initialization_id": 7109750},)"
           R"( "config_params": {"lidar_mode": ")" +
           mode + R"(", "return_order": ")" + return_order + R"("},)" +
           R"( "beam_intrinsics": {"beam_altitude_angles": )" + list_of(altitudes) +
           R"(, "beam_azimuth_angles": )" + list_of(azimuths) +
           R"(, "beam_to_lidar_transform": [1,0,0,15.8, 0,1,0,0, 0,0,1,4.2, 0,0,0,1]},)"
           R"( "lidar_intrinsics": {"lidar_to_sensor_transform":)"
           R"( [-1,0,0,0, 0,-1,0,0, 0,0,1,36.18, 0,0,0,1]},)"
           R"( "imu_intrinsics": {"imu_to_sensor_transform":)"
           R"( [1,0,0,6.253, 0,1,0,-11.775, 0,0,1,7.645, 0,0,0,1]},)"
           R"( "imu_data_format": {"imu_measurements_per_packet": 8},)"
           R"( "lidar_data_format": {"pixels_per_column": )" +
           std::to_string(pixels) + R"(, "columns_per_frame": )" + std::to_string(columns) +
           R"(, "columns_per_packet": 16, "column_window": )" + window +
           R"(, "udp_profile_lidar": ")" + profile + "\", " + imu + more + "}}";
  }

  Metadata metadata() const {
    auto parsed = parse_metadata(text());
    if (const auto* error = std::get_if<std::string>(&parsed)) {
      ADD_FAILURE() << *error;
      return {};
    }
    return std::get<Metadata>(std::move(parsed));
  }
};

template <class T>
void put(Bytes& bytes, std::size_t at, T value) {
  std::memcpy(bytes.data() + at, &value, sizeof value);
}

/// A packet of this sensor: all columns valid, starting at this time, no returns.
inline Bytes empty_packet(const Metadata& metadata, int first_column, std::uint64_t time_ns) {
  const PacketLayout layout(metadata);
  Bytes packet(layout.packet_bytes);
  if (layout.header_bytes > 0) {
    put<std::uint16_t>(packet, 0, 1);
    put<std::uint64_t>(packet, 4, std::uint64_t{7109750} | 122201000998ULL << 24);
  }
  for (int c = 0; c < layout.columns; ++c) {
    const auto at = static_cast<std::size_t>(layout.column(packet.data(), c) - packet.data());
    put<std::uint64_t>(packet, at,
                       time_ns + static_cast<std::uint64_t>(std::llround(c * layout.column_ns)));
    put<std::uint16_t>(packet, at + 8,
                       static_cast<std::uint16_t>((first_column + c) % metadata.columns_per_frame));
    packet[at + layout.status_at] = 1;
    if (layout.header_bytes == 0) put<std::uint32_t>(packet, at + layout.status_at, 0xFFFFFFFF);
  }
  return packet;
}

/// Offset of a pixel in a packet.
inline std::size_t pixel_at(const Metadata& metadata, int column, int pixel) {
  const PacketLayout layout(metadata);
  return layout.header_bytes + static_cast<std::size_t>(column) * layout.column_bytes +
         layout.column_header_bytes +
         static_cast<std::size_t>(pixel) * metadata.profile->pixel_bytes;
}

}  // namespace zloam::driver::ouster::test
