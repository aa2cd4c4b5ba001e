#pragma once
// Rings of a sensor's lasers.

#include <cstddef>
#include <cstdint>
#include <vector>

namespace zloam::driver {

/// Rank of each laser by ascending elevation; of two equal ones the later one is lower.
inline std::vector<std::uint16_t> rings_by_elevation(const std::vector<double>& elevation_deg) {
  std::vector<std::uint16_t> rings;
  rings.reserve(elevation_deg.size());
  for (std::size_t i = 0; i < elevation_deg.size(); ++i) {
    unsigned rank = 0;
    for (std::size_t other = 0; other < elevation_deg.size(); ++other) {
      const double above_deg = elevation_deg[i] - elevation_deg[other];
      rank += above_deg > 0.0 || (above_deg == 0.0 && other > i);
    }
    rings.push_back(static_cast<std::uint16_t>(rank));
  }
  return rings;
}

}  // namespace zloam::driver
