#pragma once

namespace zloam {

/// No accelerometer (m/s²) or gyroscope (rad/s) reads more in an axis. A message with more is
/// refused as a whole, so that such readings are dropped before they are sent.
inline constexpr double kMostOfReading = 1e6;

}  // namespace zloam
