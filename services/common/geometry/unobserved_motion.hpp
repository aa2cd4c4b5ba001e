#pragma once

namespace zloam {

/// Beyond this gap the motion before it does not predict where the platform is now.
inline constexpr double kLongestGap_s = 5.0;
/// Bounds of the unobserved motion in a gap: acceleration or braking, and angular rate.
inline constexpr double kUnobservedAcceleration_mps2 = 2.0, kUnobservedTurn_radps = 0.3;

}  // namespace zloam
