#pragma once
// Azimuths in hundredths of a degree, as packets carry them.

#include <algorithm>
#include <cstdint>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// Wraps into one revolution.
inline int wrapped(std::int64_t cdeg) {
  const auto rest = static_cast<int>(cdeg % kTurnCdeg);
  return rest < 0 ? rest + kTurnCdeg : rest;
}

/// Advance from one azimuth of a revolution to another, without a division.
inline int ahead(int from_cdeg, int to_cdeg) {
  return to_cdeg < from_cdeg ? to_cdeg - from_cdeg + kTurnCdeg : to_cdeg - from_cdeg;
}

inline int apart(int a_cdeg, int b_cdeg) {
  const int forward = wrapped(a_cdeg - b_cdeg);
  return std::min(forward, kTurnCdeg - forward);
}

}  // namespace zloam::driver
