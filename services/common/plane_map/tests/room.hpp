#pragma once
// A box-shaped room, ray-cast in closed form: the ground truth of the tests.

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::plane_map::testing {

struct Room {
  Eigen::Vector3d low{-5.0, -4.0, -1.5};
  Eigen::Vector3d high{5.0, 4.0, 2.0};
  bool open_x = false;  // no walls across x: an endless corridor

  /// Distance from an inside point along a unit direction; infinite without a wall.
  double range(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (int axis = open_x ? 1 : 0; axis < 3; ++axis) {
      const double d = direction[axis];
      if (std::abs(d) > 1e-9) {
        nearest = std::min(nearest, ((d > 0 ? high : low)[axis] - origin[axis]) / d);
      }
    }
    return nearest;
  }
};

struct Scanner {
  int columns = 600;
  int rings = 16;
  double lowest_deg = -25.0;
  double highest_deg = 25.0;
  std::uint32_t period_ns = 100'000'000;
  double max_range_m = 60.0;
  double noise_m = 0.0;
};

/// One sweep; every point from the pose at its own time: T_start * Exp(twist * t), clockwise. A
/// scene has the room's range().
template <typename Scene>
PointVector scan(const Scene& room, const Scanner& scanner, const Pose& T_room_start,
                 const Vector6& twist_per_s, std::mt19937& random) {
  std::normal_distribution<double> noise(0.0, 1.0);
  PointVector points;
  for (int c = 0; c < scanner.columns; ++c) {
    const auto time_ns = static_cast<std::uint32_t>(static_cast<std::uint64_t>(scanner.period_ns) *
                                                    static_cast<unsigned>(c) /
                                                    static_cast<unsigned>(scanner.columns));
    const Pose T_room_lidar = T_room_start * exp_se3(twist_per_s * (time_ns * 1e-9));
    const double azimuth = -2.0 * std::numbers::pi * c / scanner.columns;
    for (int r = 0; r < scanner.rings; ++r) {
      const double step = (scanner.highest_deg - scanner.lowest_deg) / (scanner.rings - 1);
      const double elevation = (scanner.lowest_deg + step * r) * std::numbers::pi / 180.0;
      const Eigen::Vector3d beam(std::cos(elevation) * std::cos(azimuth),
                                 std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      double range = room.range(T_room_lidar.translation(), T_room_lidar.linear() * beam);
      if (range > scanner.max_range_m) {
        continue;
      }
      range += scanner.noise_m * noise(random);
      const Eigen::Vector3f p = (beam * range).cast<float>();
      points.push_back({p.x(), p.y(), p.z(), 1.0f, time_ns, static_cast<std::uint16_t>(r),
                        ReturnType::kStrongest, 0});
    }
  }
  return points;
}

}  // namespace zloam::plane_map::testing
