#pragma once
// A 2-D scanner (Hokuyo UTM-30LX) on a motor that rotates its scan plane about its forward axis.
// Each step of a line is cast from the pose and the motor's angle at its own instant.

#include <cstdint>
#include <memory>
#include <vector>

#include "simulator/motor.hpp"
#include "simulator/scip.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator {

struct ScannerConfig {
  scip::Scanner scanner;
  /// range of measured steps: 180 degrees, as on the sensor of the LOAM paper
  int first_step = 180;
  int last_step = 900;
  double noise_sigma_m = 0.01;
  double noise_limit_sigmas = 4.0;
  double dropout = 0.01;
  double min_range_m = 0.1;
  double max_range_m = 30.0;
  double detection_reflectivity = 10.0;  ///< as in SensorConfig
  MotorConfig motor;
  /// Pose of the scanner on the rotating part of the motor.
  Pose T_motor_scanner = Pose::Identity();
  /// The device's counter at the start, ms. The value is arbitrary: a real device was switched on
  /// some time before.
  std::uint32_t counter_ms = 1'000'000;
};

/// One line: the measurements of one revolution of the scanner's mirror.
struct ScanLine {
  std::int64_t time_ns = 0;  ///< time of step 0, after the start
  std::uint32_t counter_ms = 0;
  std::vector<scip::Echo> echoes;
};

class Scanner {
 public:
  /// simulation.sensor is ignored. Throws std::invalid_argument for settings outside their limits.
  Scanner(std::shared_ptr<const Scene> scene, const SimulationConfig& simulation,
          const ScannerConfig& config);

  /// The line with this number, from 0. Does not depend on other lines.
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
