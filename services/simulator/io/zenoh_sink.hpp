#pragma once
// Publishes the sensor's packets over Zenoh, as a driver with source zenoh reads them.

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "simulator/imu.hpp"
#include "simulator/io/sinks.hpp"

namespace zloam::simulator {

struct ZenohSinkConfig {
  std::string robot = "robot";
  std::string sensor = "lidar";
  /// As a stage named simulator: listens on the sixth port from here and connects to the others';
  /// 0: neither.
  int base_port = 7460;
  std::vector<std::string> listen;      ///< replaces the own endpoint
  std::vector<std::string> connect;     ///< further endpoints
  bool block = false;                   ///< waits for a slow reader instead of dropping messages
  double wait_s = 10.0;                 ///< for a first reader, then it starts all the same
  std::int64_t batch_ns = 100'000'000;  ///< of packets in a message: one revolution of the sensor
  double rate = 1.0;                    ///< seconds of the simulation in one second
};

/// Readings until a time (ns after the start), in order; each only once.
using ImuSource = std::function<std::vector<ImuReading>(std::int64_t until_ns)>;

/// Data and position packets go to lidar/<sensor>/packets (packets.fbs) with the times at which the
/// sensor sends them; the last message says end_of_run. With an IMU, its readings go to
/// imu/<sensor> (imu.fbs). epoch_ns: Unix time of the simulation's start. Opens the session; throws
/// std::runtime_error when it cannot, std::invalid_argument for names that no key can hold.
std::unique_ptr<Sink> zenoh_sink(const ZenohSinkConfig& config, std::int64_t epoch_ns,
                                 ImuSource imu);

}  // namespace zloam::simulator
