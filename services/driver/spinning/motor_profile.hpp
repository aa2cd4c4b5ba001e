#pragma once
// The angle of a motor that nobody reads: it runs by the host's clock as it was told.

#include <cstdint>

namespace zloam::driver::spinning {

/// To and fro, or on and on, at one speed; a swing's reversals at constant acceleration.
struct MotorProfile {
  /// Unix time at which a swing rests at -amplitude, and a turning motor is at zero
  double from_s = 0.0;
  double speed_radps = 0.0;
  /// of a swing, to either side; 0: it turns on and on
  double amplitude_rad = 0.0;
  /// from full speed one way to full speed the other way
  double reversal_s = 0.0;

  /// Not wrapped. At any time, before from_s too.
  double angle_rad(std::int64_t stamp_ns) const;
  /// In which a scanner sees all directions once: a swing one way, or half a turn.
  double turn_s() const;
};

}  // namespace zloam::driver::spinning
