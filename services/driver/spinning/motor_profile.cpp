#include "driver/spinning/motor_profile.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace zloam::driver::spinning {

double MotorProfile::turn_s() const {
  if (amplitude_rad <= 0.0) return std::numbers::pi / speed_radps;
  // Both ramps of a swing together take twice the time that their angle takes at full speed.
  return 2.0 * amplitude_rad / speed_radps + 0.5 * reversal_s;
}

double MotorProfile::angle_rad(std::int64_t stamp_ns) const {
  // As a double, today's Unix time resolves only 0.25 microseconds: subtract whole seconds as
  // integers.
  const double whole_s = std::floor(from_s);
  const auto since_ns = stamp_ns - std::llround(whole_s) * 1'000'000'000;
  const double since_s = 1e-9 * static_cast<double>(since_ns) - (from_s - whole_s);
  if (amplitude_rad <= 0.0) return speed_radps * since_s;
  const double swing_s = turn_s();
  const double number = std::floor(since_s / swing_s);
  const double ramp_s = 0.5 * reversal_s;
  const double in_swing_s = since_s - number * swing_s;
  // Time within the first half of a swing; the second half is its mirror image.
  const double s = std::min(in_swing_s, swing_s - in_swing_s);
  const double way_rad =
      s < ramp_s ? 0.5 * speed_radps / ramp_s * s * s : speed_radps * (s - 0.5 * ramp_s);
  const double from_low_rad = in_swing_s <= 0.5 * swing_s ? way_rad : 2.0 * amplitude_rad - way_rad;
  const bool up = std::fmod(number, 2.0) == 0.0;
  return up ? from_low_rad - amplitude_rad : amplitude_rad - from_low_rad;
}

}  // namespace zloam::driver::spinning
