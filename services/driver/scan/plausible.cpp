#include "driver/scan/plausible.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "driver/scan/scan.hpp"

namespace zloam::driver {
namespace {

constexpr double kDegPerRad = 180.0 / M_PI;
// In any environment, the median range of a scan is between these.
constexpr double kNearestMiddleM = 0.1;
constexpr double kFarthestMiddleM = 300.0;
// A full scan with fewer rings than this is not stored ring by ring.
constexpr int kFewestRings = 4;
constexpr std::size_t kWholeScan = 2000;
// Limit for the spread of elevation within a ring: 0.25 to 0.4 degrees in scans of an HDL-64E, at
// least 4 degrees if the points are in another order.
constexpr double kConeDeg = 2.0;

std::string text_of(const char* format, double value) {
  char text[256];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

std::string wrong_range(std::vector<double>& ranges_m) {
  const auto middle = ranges_m.begin() + static_cast<std::ptrdiff_t>(ranges_m.size() / 2);
  std::nth_element(ranges_m.begin(), middle, ranges_m.end());
  if (*middle >= kNearestMiddleM && *middle <= kFarthestMiddleM) return {};
  return text_of("half of its returns lie within %.4g m, which no lidar sees: metres are expected",
                 *middle);
}

std::string too_many_rings(int rings) {
  return std::to_string(rings) + " rings, of " + std::to_string(kMostRings) + " that a lidar has";
}

}  // namespace

std::string implausible(std::span<const float> xyzi) {
  int rings = 0;
  const std::vector<std::uint16_t> ring = recover_rings(xyzi, rings);
  std::vector<double> ranges_m, elevation_deg;
  std::vector<std::size_t> of_ring;
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const double x = xyzi[4 * i], y = xyzi[4 * i + 1], z = xyzi[4 * i + 2];
    const double range_m = std::hypot(x, y, z);
    if (!std::isfinite(range_m) || range_m == 0.0) continue;
    ranges_m.push_back(range_m);
    elevation_deg.push_back(std::atan2(z, std::hypot(x, y)) * kDegPerRad);
    of_ring.push_back(ring[i]);
  }
  if (ranges_m.size() < kJudgedReturns) return {};
  if (rings > kMostRings) {
    return too_many_rings(rings) + ": 4 floats a point (x y z reflectance), ring by ring, expected";
  }
  std::vector<double> count(static_cast<std::size_t>(rings), 0.0), mean(count), square(count);
  for (std::size_t i = 0; i < of_ring.size(); ++i) {
    const double step = elevation_deg[i] - mean[of_ring[i]];
    mean[of_ring[i]] += step / ++count[of_ring[i]];
    square[of_ring[i]] += step * (elevation_deg[i] - mean[of_ring[i]]);
  }
  double squares = 0.0;
  for (const double s : square) squares += s;
  const double spread_deg = std::sqrt(squares / static_cast<double>(of_ring.size()));
  if (std::string text = wrong_range(ranges_m); !text.empty()) return text;
  if (rings < kFewestRings && of_ring.size() > kWholeScan) {
    return std::to_string(rings) + " rings only: its points are not stored ring by ring";
  }
  if (spread_deg <= kConeDeg) return {};
  return text_of(
      "points of one ring differ by %.1f deg of elevation: they are not stored ring by "
      "ring, each counter-clockwise from the front",
      spread_deg);
}

std::string implausible(const DecodedSweep& sweep) {
  if (sweep.points.size() < kJudgedReturns) return {};
  if (sweep.rings > kMostRings) return too_many_rings(sweep.rings);
  std::vector<double> ranges_m;
  for (const Point& p : sweep.points) ranges_m.push_back(p.position().cast<double>().norm());
  return wrong_range(ranges_m);
}

}  // namespace zloam::driver
