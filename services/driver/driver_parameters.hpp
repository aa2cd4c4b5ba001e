#pragma once
// Configuration of the driver: section driver of the robot's file.

#include <optional>
#include <string>
#include <vector>

#include "common/runtime/config.hpp"
#include "common/runtime/parameters.hpp"
#include "driver/io/packet_source.hpp"
#include "driver/io/scip_source.hpp"
#include "driver/io/sweep_source.hpp"

namespace zloam::driver {

enum class SourceKind : std::uint8_t {
  kUdp,
  kPcap,
  kBin,
  kKitti,
  kScans,
  kRecording,
  kZenoh,
  kScip,
  kScipLog
};
enum class ImuChoice : std::uint8_t { kNone, kFile, kZenoh, kSensor };
enum class ClockChoice : std::uint8_t { kAuto, kReceive, kUtc, kFree };
enum class ReturnChoice : std::uint8_t { kAuto, kStrongest, kLast, kDual };

struct DriverConfig {
  SourceKind source = SourceKind::kUdp;
  /// file or folder of a finite source, or the device of a scanner
  std::string path;
  /// of a recording: topic of the clouds, and the program that reads it
  std::string topic;
  std::string imu_topic;
  std::string time_field;
  std::string reader = "zloam";
  /// "max": as fast as the chain acknowledges; "realtime"; or a factor, e.g. "0.5"
  std::string rate = "max";
  /// "auto", or one of known_models()
  std::string model = "auto";
  /// file in which the sensor describes itself
  std::string metadata;
  ReturnChoice returns = ReturnChoice::kAuto;
  DualReturns dual_returns = DualReturns::kTagged;
  bool vertical_offsets = true;
  double min_range_m = 0.0;
  double max_range_m = 1000.0;
  /// pairs from, to; degrees clockwise from the front
  std::vector<std::string> azimuth_mask_deg;
  Eigen::Vector3d body_box_min_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d body_box_max_m = Eigen::Vector3d::Zero();
  UdpOptions udp;
  /// only packets of this sender; empty: of the first one seen
  std::string sensor_address;
  double seam_azimuth_deg = 0.0;
  double guard_s = 0.3;
  int reorder_packets = 4;
  ClockChoice clock = ClockChoice::kAuto;
  double stamp_offset_us = 0.0;
  ScanTiming scan;
  ImuChoice imu = ImuChoice::kNone;
  /// file of recorded readings
  std::string imu_path;
  /// delay of the readings' stamps
  double imu_delay_ms = 0.0;
  /// live: seconds without a packet before a warning
  double quiet_s = 3.0;
};

void bind(runtime::Parameters& p, DriverConfig& c);

/// Realtime factor; nothing for "max". The text has passed the check of bind().
std::optional<double> rate_factor(const std::string& rate);

bool is_live(SourceKind source);

/// Parses the pairs of the mask; throws SourceError for an invalid one.
std::vector<AzimuthSector> azimuth_sectors(const std::vector<std::string>& texts);

PointLimits point_limits(const DriverConfig& config, const Pose& T_base_lidar);

/// Of a scanner on a motor, with the file in driver.metadata. Throws SourceError.
ScipSourceConfig scip_source_config(const DriverConfig& config, const Pose& T_base_lidar);

PacketStreamConfig packet_stream_config(const DriverConfig& config,
                                        const runtime::SharedConfig& shared);

}  // namespace zloam::driver
