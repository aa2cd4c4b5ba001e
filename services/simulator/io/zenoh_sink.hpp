#pragma once
// Publishes the sensor's packets over Zenoh, for a driver with `driver.source: zenoh`.

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
  /// Endpoints like those of a stage: listens on the sixth port from this one and connects to the
  /// stages' ports; 0: neither.
  int base_port = 7460;
  std::vector<std::string> listen;      ///< replaces the default listen endpoint
  std::vector<std::string> connect;     ///< further endpoints to connect to
  bool block = false;                   ///< wait for a slow reader instead of dropping messages
  double wait_s = 10.0;                 ///< longest wait for a first reader before the start
  std::int64_t batch_ns = 100'000'000;  ///< time covered by a message: one revolution
  double rate = 1.0;                    ///< seconds of the simulation per second
};

/// Returns the readings up to a time (ns after the start), in order, each only once.
using ImuSource = std::function<std::vector<ImuReading>(std::int64_t until_ns)>;

/// Publishes data and position packets as lidar/<sensor>/packets (packets.fbs), with the times at
/// which the sensor sends them; the last message has end_of_run set. Readings of an IMU, if given,
/// go to imu/<sensor> (imu.fbs). epoch_ns: Unix time of the simulation's start. Opens the session;
/// throws std::runtime_error if that fails, std::invalid_argument for names that no key can have.
std::unique_ptr<Sink> zenoh_sink(const ZenohSinkConfig& config, std::int64_t epoch_ns,
                                 ImuSource imu);

}  // namespace zloam::simulator
