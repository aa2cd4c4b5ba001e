#pragma once
// A 2-D scanner (Hokuyo UTM-30LX) on a motor that turns its plane about its forward axis: casts
// every step of every line from the pose and the motor's angle at its own instant.

#include <cstdint>
#include <memory>
#include <vector>

#include "simulator/motor.hpp"
#include "simulator/scip.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator {

struct ScannerConfig {
  scip::Scanner scanner;
  /// steps that are measured; 180 degrees, as the LOAM rig had them
  int first_step = 180;
  int last_step = 900;
  double noise_sigma_m = 0.01;
  double noise_limit_sigmas = 4.0;
  double dropout = 0.01;
  double min_range_m = 0.1;
  double max_range_m = 30.0;
  double detection_reflectivity = 10.0;  ///< as in SensorConfig
  MotorConfig motor;
  /// Carries points of the scanner into what the motor turns.
  Pose T_motor_scanner = Pose::Identity();
  /// The device's counter at the start, ms; any, as the device was switched on some time before.
  std::uint32_t counter_ms = 1'000'000;
};

/// One turn of the scanner.
struct ScanLine {
  std::int64_t time_ns = 0;  ///< of step 0, after the start
  std::uint32_t counter_ms = 0;
  std::vector<scip::Echo> echoes;
};

class Scanner {
 public:
  /// Of simulation.sensor nothing counts. Throws std::invalid_argument.
  Scanner(std::shared_ptr<const Scene> scene, const SimulationConfig& simulation,
          const ScannerConfig& config);

  /// Line number index, from 0; depends on nothing else.
  ScanLine line(std::int64_t index) const;
  std::int64_t line_count(double duration_s) const;
  const Motor& motor() const { return motor_; }
  const ScannerConfig& config() const { return config_; }

 private:
  scip::Echo measure(int step, std::int64_t step0_ns, const std::vector<MovingShape>& moving) const;

  std::shared_ptr<const Scene> scene_;
  SimulationConfig simulation_;
  ScannerConfig config_;
  Motor motor_;
};

}  // namespace zloam::simulator
