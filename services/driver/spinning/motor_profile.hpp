#pragma once
// The angle of a motor without encoder readings: it follows its commands by the host's clock.

#include <cstdint>

namespace zloam::driver::spinning {

/// Swings, or rotates continuously, at one speed; a swing reverses at constant acceleration.
struct MotorProfile {
  /// Unix time at which a swing rests at -amplitude, and a rotating motor is at zero
  double from_s = 0.0;
  double speed_radps = 0.0;
  /// of a swing, to either side; 0: continuous rotation
  double amplitude_rad = 0.0;
  /// from full speed in one direction to full speed in the other
  double reversal_s = 0.0;

  /// Unwrapped. Valid at any time, also before from_s.
  double angle_rad(std::int64_t stamp_ns) const;
  /// Time in which a scanner sees all directions once: one swing, or half a revolution.
  double turn_s() const;
};

}  // namespace zloam::driver::spinning
