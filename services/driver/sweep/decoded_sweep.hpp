#pragma once
// Output of every source of this stage: one revolution of the sensor.

#include <cstdint>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// Where a sweep's stamps come from; values of the message's enumeration.
enum class ClockSource : std::uint8_t {
  kUnknown = 0,
  kSensorGps = 1,
  kSensorFreeRunning = 2,
  kHost = 3,
  kCapture = 4,
  kSynthetic = 5
};

struct DecodedSweep {
  /// returns in time order, frame lidar; time_ns after stamp_ns
  PointVector points;
  /// firing column of each point
  std::vector<std::uint16_t> columns;
  /// time of the first point (of the first firing when there is no return), ns since the Unix epoch
  std::int64_t stamp_ns = 0;
  /// measured time of one revolution; 0 when it could not be measured
  std::uint32_t period_ns = 0;
  std::uint16_t rings = 0;
  std::string model;
  ReturnMode return_mode = ReturnMode::kUnknown;
  ClockSource clock_source = ClockSource::kUnknown;
  /// false for the first and the last sweep of a source, with lost packets, and when no revolution
  /// was completed
  bool complete = false;
  std::uint32_t packets = 0;
  std::uint32_t packets_lost = 0;
  /// sensor's own time of the first and the last packet, us since the top of its hour
  std::uint32_t first_packet_toh_us = 0;
  std::uint32_t last_packet_toh_us = 0;
  /// from one packet's stamp to the next one's; 0: the source has no packets
  std::uint32_t packet_period_ns = 0;
  /// receive time of the last packet, ns since the Unix epoch; 0 when unknown
  std::int64_t last_packet_ns = 0;
  /// detected steps of the host's and the sensor's clock since the sweep before; the stamps do not
  /// follow them
  std::int64_t host_clock_step_ns = 0;
  std::int64_t sensor_clock_step_ns = 0;
  /// true when the source moved the points to one instant already
  bool deskewed = false;
  /// number of consecutive sweeps that together cover a revolution
  std::uint16_t slices = 1;
};

}  // namespace zloam::driver
