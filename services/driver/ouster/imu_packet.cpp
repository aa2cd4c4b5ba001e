#include "driver/ouster/imu_packet.hpp"

#include <numbers>

#include "driver/ouster/packet.hpp"

namespace zloam::driver::ouster {
namespace {

constexpr std::uint64_t kHourNs = 3'600'000'000'000;
constexpr double kStandardGravity_mps2 = 9.80665;
constexpr double kRadPerDeg = std::numbers::pi / 180.0;

std::int64_t toh_ns(std::uint64_t time_ns) { return static_cast<std::int64_t>(time_ns % kHourNs); }

Eigen::Vector3d vector_at(const std::uint8_t* at) {
  return {read_as<float>(at), read_as<float>(at + 4), read_as<float>(at + 8)};
}

/// Times of acceleration and angular rate, by the lidar's clock.
struct LegacyTimes {
  std::uint64_t force_ns;
  std::uint64_t rate_ns;

  std::int64_t apart_ns() const { return static_cast<std::int64_t>(rate_ns - force_ns); }
};

LegacyTimes legacy_times(const std::uint8_t* packet) {
  return {read_as<std::uint64_t>(packet + 8), read_as<std::uint64_t>(packet + 16)};
}

/// In g, and in degrees per second.
Eigen::Vector3d legacy_force(const std::uint8_t* packet) { return vector_at(packet + 24); }
Eigen::Vector3d legacy_rate(const std::uint8_t* packet) { return vector_at(packet + 36); }

bool is_legacy(const std::uint8_t* packet) {
  constexpr std::int64_t kMostApartNs = 100'000'000;
  constexpr double kMost_g = 100.0;
  constexpr double kMost_dps = 10'000.0;
  const std::int64_t apart_ns = legacy_times(packet).apart_ns();
  return apart_ns > -kMostApartNs && apart_ns < kMostApartNs &&
         (legacy_force(packet).array().abs() < kMost_g).all() &&
         (legacy_rate(packet).array().abs() < kMost_dps).all();
}

ImuReading legacy_reading(const std::uint8_t* packet, const Eigen::Matrix3d& R_sensor_imu) {
  // They are measured 0.2 ms apart; the middle serves as the time of both.
  const LegacyTimes times = legacy_times(packet);
  return {toh_ns(times.force_ns + static_cast<std::uint64_t>(times.apart_ns() / 2)),
          R_sensor_imu * (kStandardGravity_mps2 * legacy_force(packet)),
          R_sensor_imu * (kRadPerDeg * legacy_rate(packet))};
}

/// In metres per second squared and radians per second.
std::vector<ImuReading> many_readings(const std::uint8_t* packet, const Metadata& metadata,
                                      const Eigen::Matrix3d& R_sensor_imu) {
  constexpr std::size_t kFirstAt = 32 + 100;
  constexpr std::size_t kReadingBytes = 36;
  std::vector<ImuReading> readings;
  for (int i = 0; i < metadata.imu_readings_per_packet; ++i) {
    const std::uint8_t* const at = packet + kFirstAt + static_cast<std::size_t>(i) * kReadingBytes;
    const bool valid = (read_as<std::uint16_t>(at + 10) & 1) != 0;
    if (!valid) continue;
    readings.push_back({toh_ns(read_as<std::uint64_t>(at)), R_sensor_imu * vector_at(at + 12),
                        R_sensor_imu * vector_at(at + 24)});
  }
  return readings;
}

}  // namespace

bool is_imu_packet(std::span<const std::uint8_t> payload, const Metadata& metadata) {
  if (payload.size() != metadata.imu_packet_bytes()) return false;
  return metadata.imu_readings_per_packet > 0 || is_legacy(payload.data());
}

std::vector<ImuReading> parse_imu(std::span<const std::uint8_t> payload, const Metadata& metadata) {
  if (!is_imu_packet(payload, metadata)) return {};
  const Eigen::Matrix3d R_sensor_imu = metadata.T_sensor_imu.linear();
  if (metadata.imu_readings_per_packet > 0) {
    return many_readings(payload.data(), metadata, R_sensor_imu);
  }
  return {legacy_reading(payload.data(), R_sensor_imu)};
}

}  // namespace zloam::driver::ouster
