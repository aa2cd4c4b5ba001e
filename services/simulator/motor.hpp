#pragma once
// The motor that rotates a 2-D scanner: its angle at every instant, and its encoder's readings.

#include <cstdint>
#include <vector>

namespace zloam::simulator {

enum class MotorKind : std::uint8_t { kStill, kSwing, kTurn };

struct MotorConfig {
  MotorKind kind = MotorKind::kSwing;
  double speed_deg_s = 180.0;
  double amplitude_deg = 90.0;  ///< largest angle of a swing, to either side
  double reversal_s = 0.06;     ///< time in which a swing reverses its direction
  double still_deg = 0.0;       ///< angle of a motor that stands still
  double encoder_hz = 500.0;    ///< readings per second
  double encoder_step_deg = 0.25;
  double encoder_delay_s = 0.0;  ///< how much later than the true time a reading is stamped
};

/// One reading of the encoder.
struct AngleReading {
  std::int64_t time_ns = 0;  ///< stamp of the reading, after the start
  double angle_rad = 0.0;
};

/// Angles are about the scanner's forward axis, right-handed, 0 where the scan plane is level. A
/// swing starts at -amplitude, at rest.
class Motor {
 public:
  /// Throws std::invalid_argument for settings outside their limits.
  explicit Motor(const MotorConfig& config);

  double angle_rad(double time_s) const;
  /// Time from one reversal to the next, s; for a rotating motor that of half a rotation, for a
  /// motor that stands still 1 s.
  double sweep_s() const;
  /// The readings with index first ... first + count - 1, measured at index / encoder_hz.
  std::vector<AngleReading> readings(std::int64_t first, std::int64_t count) const;

 private:
  MotorConfig config_;
};

}  // namespace zloam::simulator
