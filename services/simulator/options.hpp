#pragma once
// The program's command line.

#include <cstdint>
#include <optional>
#include <string>

#include "simulator/faults.hpp"
#include "simulator/imu.hpp"
#include "simulator/io/scanner_files.hpp"
#include "simulator/io/zenoh_sink.hpp"
#include "simulator/scenes.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator {

struct Options {
  std::string world = "city";
  SceneOptions scene;
  SimulationConfig simulation;
  FaultConfig faults;
  ImuConfig imu_config;
  /// the platform stays at its first pose
  bool still = false;
  /// simulate a Hokuyo on a motor instead of the VLP-16
  bool scans = false;
  ScannerConfig scanner;
  ScannerFiles scanner_files;
  double duration_s = 0.0;  ///< 0: the whole motion
  int threads = 2;
  bool quiet = false;
  bool nanoseconds = false;
  std::string pcap, payloads, returns, fault_log;
  std::string truth, truth_base, truth_sweeps, imu;
  std::string udp_address;
  std::uint16_t udp_port = vlp16::kDataPort;
  std::uint16_t udp_position_port = vlp16::kPositionPort;
  double rate = 1.0;
  bool zenoh = false;
  bool zenoh_imu = false;
  ZenohSinkConfig zenoh_config;
};

/// Fills in the options, or returns an exit code if the program must end at once (help, version,
/// list or an error, which have been printed).
std::optional<int> parse_options(int argc, char** argv, Options& options);

}  // namespace zloam::simulator
