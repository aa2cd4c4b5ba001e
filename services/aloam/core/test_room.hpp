#pragma once
// Sweeps of a 16-ring lidar in a furnished room, each ray cast from where the sensor is at its
// time. Shares no code with what it tests.

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/geometry/test_box.hpp"

namespace zloam::aloam::test {

inline constexpr std::uint32_t kPeriod_ns = 100'000'000;
inline constexpr int kColumns = 1800;

using zloam::test::Box;
using zloam::test::slab;

/// 20 x 14 x 4 m with pillars and crates.
inline double range_in_room(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) {
  static const Box hull{{-8.0, -6.0, -1.3}, {12.0, 8.0, 2.7}};
  static const std::vector<Box> boxes = {{{3.0, 2.0, -1.3}, {4.0, 3.0, 2.7}},
                                         {{-4.0, -3.0, -1.3}, {-3.2, -2.0, 2.7}},
                                         {{-2.0, 4.0, -1.3}, {-1.2, 5.0, 1.4}},
                                         {{6.0, -4.0, -1.3}, {7.5, -2.5, 2.0}}};
  double range = slab(hull, from, ray).second;
  for (const Box& box : boxes) {
    const auto [near, far] = slab(box, from, ray);
    if (near < far && near > 0.0) range = std::min(range, near);
  }
  return range;
}

/// `pose` of a share of the sweep's time, 0 to 1.
inline PointVector sweep(const std::function<Pose(double)>& pose, double noise_m = 0.0,
                         unsigned seed = 1) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  PointVector out;
  for (int column = 0; column < kColumns; ++column) {
    const double share = static_cast<double>(column) / kColumns;
    const Pose T = pose(share);
    for (std::uint16_t ring = 0; ring < 16; ++ring) {
      const double azimuth = -2.0 * M_PI * share;
      const double elevation = (-15.0 + 2.0 * ring) * M_PI / 180.0;
      const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth),
                                std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const double range =
          range_in_room(T.translation(), T.linear() * ray) + noise_m * noise(generator);
      const Eigen::Vector3f p = (range * ray).cast<float>();
      out.push_back({p.x(), p.y(), p.z(), 10.0F, static_cast<std::uint32_t>(share * kPeriod_ns),
                     ring, ReturnType::kStrongest, 0});
    }
  }
  return out;
}

inline PointVector sweep_at(const Pose& pose, double noise_m = 0.0, unsigned seed = 1) {
  return sweep([&](double) { return pose; }, noise_m, seed);
}

}  // namespace zloam::aloam::test
