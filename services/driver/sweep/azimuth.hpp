#pragma once
// Azimuths in hundredths of a degree, as packets carry them.

#include <algorithm>
#include <cstdint>

#include "driver/velodyne/decoder.hpp"

namespace zloam::driver {

/// Into one turn.
inline int wrapped(std::int64_t cdeg) {
  const auto rest = static_cast<int>(cdeg % kTurnCdeg);
  return rest < 0 ? rest + kTurnCdeg : rest;
}

inline int apart(int a_cdeg, int b_cdeg) {
  const int forward = wrapped(a_cdeg - b_cdeg);
  return std::min(forward, kTurnCdeg - forward);
}

}  // namespace zloam::driver
