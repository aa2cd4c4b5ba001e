#pragma once
// A world of boxes with exact truth for the tests: rays of a 16-ring sensor, and which of the hits
// lie on an edge between two faces. Shares no code with what it tests.

#include <algorithm>
#include <cmath>
#include <random>
#include <utility>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "common/geometry/test_box.hpp"

namespace zloam::mapping::test {

using zloam::test::Box;
using zloam::test::slab;

struct Scan {
  PointVector edges;   // frame of the sensor
  PointVector planes;  // likewise
};

/// Boxes seen from outside, inside one box (the room) seen from inside.
struct Room {
  Box hull;
  std::vector<Box> boxes;

  /// Range along the ray, and the distance of the hit from the nearest edge of what was hit.
  std::pair<double, double> cast(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    double range = slab(hull, from, ray).second;
    Box hit = hull;
    for (const Box& box : boxes) {
      const auto [near, far] = slab(box, from, ray);
      if (near < far && near > 0.0 && near < range) {
        range = near;
        hit = box;
      }
    }
    const Eigen::Vector3d p = from + range * ray;
    Eigen::Vector3d to_face;
    for (int a = 0; a < 3; ++a) {
      to_face[a] = std::min(std::abs(p[a] - hit.low[a]), std::abs(p[a] - hit.high[a]));
    }
    std::sort(to_face.data(), to_face.data() + 3);
    return {range, to_face[1]};
  }
};

/// 20 x 14 x 4 m with three pillars, off the axes' origin.
inline Room furnished_room() {
  return {{{-8.0, -6.0, -1.3}, {12.0, 8.0, 2.7}},
          {{{3.0, 2.0, -1.3}, {4.0, 3.0, 2.7}},
           {{-4.0, -3.0, -1.3}, {-3.2, -2.0, 0.4}},
           {{6.0, -4.0, -1.3}, {7.5, -2.5, 1.0}}}};
}

/// 400 m long, 4 m wide, 3 m high, nothing in it.
inline Room corridor() { return {{{-200.0, -2.0, -1.2}, {200.0, 2.0, 1.8}}, {}}; }

/// The same with pillars on both sides, none of which stands like another.
inline Room corridor_with_pillars() {
  Room out = corridor();
  double x = -40.0;
  for (int i = 0; x < 80.0; ++i) {
    const double y = i % 2 == 0 ? 1.4 : -2.0;
    out.boxes.push_back({{x, y, -1.2}, {x + 0.5 + 0.1 * (i % 3), y + 0.6, 1.8}});
    x += 1.7 + 0.37 * (i % 4);
  }
  return out;
}

inline Scan scan(const Room& room, const Pose& T_map_base, double noise_m, unsigned seed,
                 double max_range_m = 60.0, double plane_gap_m = 0.2) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  Scan out;
  constexpr int kColumns = 900;
  for (int column = 0; column < kColumns; ++column) {
    for (std::uint16_t ring = 0; ring < 16; ++ring) {
      const double azimuth = 2.0 * M_PI * column / kColumns;
      const double elevation = (-15.0 + 2.0 * ring) * M_PI / 180.0;
      const Eigen::Vector3d ray_base(std::cos(elevation) * std::cos(azimuth),
                                     std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const auto [range, edge_m] =
          room.cast(T_map_base.translation(), T_map_base.linear() * ray_base);
      if (range > max_range_m) continue;
      const Eigen::Vector3d p = (range + noise_m * noise(generator)) * ray_base;
      const Point point{static_cast<float>(p.x()),
                        static_cast<float>(p.y()),
                        static_cast<float>(p.z()),
                        10.0F,
                        static_cast<std::uint32_t>(column * 111111),
                        ring,
                        ReturnType::kStrongest,
                        0};
      // Feature extraction leaves out the points between the two: a mean over a corner lies on no
      // face.
      if (edge_m < 0.04) out.edges.push_back(point);
      if (edge_m > plane_gap_m) out.planes.push_back(point);
    }
  }
  return out;
}

}  // namespace zloam::mapping::test
