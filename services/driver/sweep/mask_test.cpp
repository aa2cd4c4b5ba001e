#include "driver/sweep/mask.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace zloam::driver {
namespace {

/// A point 10 m away, at an azimuth clockwise from the front.
Point at_azimuth(double azimuth_deg) {
  const double a = azimuth_deg * std::numbers::pi / 180.0;
  Point point{};
  point.x = static_cast<float>(10.0 * std::cos(a));
  point.y = static_cast<float>(-10.0 * std::sin(a));
  return point;
}

Point at(float x, float y, float z) {
  Point point{};
  point.x = x;
  point.y = y;
  point.z = z;
  return point;
}

TEST(Mask, NothingIsLeftOutUnlessAskedFor) {
  const PointMask mask({});
  EXPECT_FALSE(mask.active());
  for (int deg = 0; deg < 360; ++deg) EXPECT_TRUE(mask.keeps(at_azimuth(deg)));
}

TEST(Mask, ASectorThroughTheFrontAndOneThatIsNot) {
  const PointMask through({.sectors = {{350.0, 10.0}}});
  const PointMask plain({.sectors = {{10.0, 350.0}}});
  for (int deg = 0; deg < 360; ++deg) {
    if (deg == 10 || deg == 350) continue;
    SCOPED_TRACE(deg);
    const bool near_front = deg < 10 || deg > 350;
    EXPECT_EQ(through.keeps(at_azimuth(deg)), !near_front);
    EXPECT_EQ(plain.keeps(at_azimuth(deg)), near_front);
  }
}

TEST(Mask, SeveralSectors) {
  const PointMask mask({.sectors = {{80.0, 100.0}, {260.0, 280.0}}});
  EXPECT_FALSE(mask.keeps(at_azimuth(90.0)));
  EXPECT_FALSE(mask.keeps(at_azimuth(270.0)));
  EXPECT_TRUE(mask.keeps(at_azimuth(0.0)));
  EXPECT_TRUE(mask.keeps(at_azimuth(180.0)));
}

TEST(Mask, TheBodyIsABoxInBaseLink) {
  // The lidar is 1 m ahead of base_link and faces left.
  const Pose T_base_lidar = pose_from_xyz_rpy_deg({1.0, 0.0, 0.5}, {0.0, 0.0, 90.0});
  const PointMask mask({.body_min_m = {-0.5, -0.3, 0.0},
                        .body_max_m = {0.5, 0.3, 1.0},
                        .T_base_lidar = T_base_lidar});
  const Eigen::Vector3d inside = T_base_lidar.inverse() * Eigen::Vector3d(0.4, 0.2, 0.9);
  const Eigen::Vector3d outside = T_base_lidar.inverse() * Eigen::Vector3d(0.6, 0.2, 0.9);
  EXPECT_FALSE(mask.keeps(at(static_cast<float>(inside.x()), static_cast<float>(inside.y()),
                             static_cast<float>(inside.z()))));
  EXPECT_TRUE(mask.keeps(at(static_cast<float>(outside.x()), static_cast<float>(outside.y()),
                            static_cast<float>(outside.z()))));
  EXPECT_TRUE(mask.keeps(at(0.0F, 0.0F, 0.0F))) << "the lidar itself is outside of this box";
}

TEST(Mask, ABoxWithoutVolumeIsNone) {
  EXPECT_FALSE(
      PointMask({.body_min_m = {-1.0, -1.0, 0.5}, .body_max_m = {1.0, 1.0, 0.5}}).active());
}

TEST(Mask, ColumnsStayWithTheirPoints) {
  const PointMask mask({.sectors = {{90.0, 180.0}}});
  std::vector<Point> points;
  std::vector<std::uint16_t> columns;
  for (int i = 0; i < 360; ++i) {
    points.push_back(at_azimuth(i + 0.5));
    points.back().ring = static_cast<std::uint16_t>(i);
    columns.push_back(static_cast<std::uint16_t>(i));
  }
  ASSERT_EQ(mask.apply(points.data(), columns.data(), points.size()), 270U);
  for (std::size_t i = 0; i < 270; ++i) {
    EXPECT_EQ(points[i].ring, columns[i]);
    EXPECT_EQ(columns[i], i < 90 ? i : i + 90);
  }
}

}  // namespace
}  // namespace zloam::driver
