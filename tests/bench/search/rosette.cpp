#include "rosette.hpp"

#include <cmath>
#include <numbers>
#include <stdexcept>

namespace zloam::search {

using std::numbers::pi;

// With a view of 360 degrees the first part rotates the beam about the vertical axis, and the
// second one swings it up and down. With a narrower view the parts rotate in opposite directions,
// as two prisms do, and the sum of their deflections fills the view.
Eigen::Vector3d Rosette::direction(double time_s, std::size_t laser) const {
  const double share = static_cast<double>(laser) / static_cast<double>(lasers);
  const double first = 2.0 * pi * std::fmod(first_hz * time_s, 1.0);
  const double second = 2.0 * pi * std::fmod(second_hz * time_s + share, 1.0);
  const double half_height = 0.5 * (high_deg - low_deg) * pi / 180.0;
  const double middle = 0.5 * (high_deg + low_deg) * pi / 180.0;
  double azimuth = -first, elevation = middle + half_height * std::sin(second);
  if (view_deg < 360.0) {
    azimuth = 0.25 * view_deg * pi / 180.0 * (std::cos(first) + std::cos(second));
    elevation = middle + 0.5 * half_height * (std::sin(first) - std::sin(second));
  }
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
          std::sin(elevation)};
}

Rosette rosette_named(const std::string& name) {
  if (name == "mid360") {
    return {.lasers = 4,
            .points_per_s = 200e3,
            .view_deg = 360.0,
            .low_deg = -7.0,
            .high_deg = 52.0,
            .first_hz = 33.17,
            .second_hz = 181.3};
  }
  if (name == "hap") {
    return {.lasers = 6,
            .points_per_s = 452e3,
            .view_deg = 120.0,
            .low_deg = -12.5,
            .high_deg = 12.5,
            .first_hz = 121.7,
            .second_hz = 73.19};
  }
  throw std::invalid_argument("lidar.pattern: " + name + " is none of beams, mid360, hap");
}

}  // namespace zloam::search
