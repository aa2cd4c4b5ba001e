// Reduced weight of correlated points that lie close together (crowd_points).

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "common/plane_map/tests/from_rest.hpp"
#include "common/plane_map/tests/grid.hpp"

namespace zloam::plane_map {
namespace {

using Eigen::Vector3d;

constexpr double kNowhere_m = std::numeric_limits<double>::infinity();

// A straight street: ground, a wall on either side, boards across it beside the road, and two vans
// that keep their distance from the sensor, one ahead and one behind.
struct Street {
  static constexpr double kAhead_m = 12.0, kBehind_m = 11.0;
  static constexpr double kBoardsApart_m = 12.0, kBoard_m = 0.5;

  double range(const Vector3d& origin, const Vector3d& direction) const {
    double nearest = to_van(direction);
    if (direction.z() < 0.0) nearest = std::min(nearest, (-1.6 - origin.z()) / direction.z());
    if (direction.y() != 0.0) {
      nearest = std::min(nearest, (std::copysign(9.0, direction.y()) - origin.y()) / direction.y());
    }
    for (int k = -4; k < 7; ++k) {
      nearest = std::min(nearest, to_board(kBoardsApart_m * k + 4.0, origin, direction));
    }
    return nearest;
  }

  static double to_van(const Vector3d& direction) {
    const double range = (direction.x() > 0.0 ? kAhead_m : kBehind_m) / std::abs(direction.x());
    const bool hit = std::abs(range * direction.y()) < 1.0 && range * direction.z() < 0.8;
    return hit ? range : kNowhere_m;
  }

  static double to_board(double x, const Vector3d& origin, const Vector3d& direction) {
    const double range = (x - origin.x()) / direction.x();
    const Vector3d at = origin + range * direction;
    const bool hit = range > 0.0 && std::abs(std::abs(at.y()) - 6.0) < kBoard_m && at.z() < 0.2;
    return hit ? range : kNowhere_m;
  }
};

double error_m(double crowd_points) {
  MatcherConfig matcher;
  matcher.crowd_points = crowd_points;
  return testing::worst_from_rest_m(Street{}, 0.15, 4.0, 4, PlaneMapConfig{}, matcher);
}

TEST(Crowd, TwoVansDoNotTakeTheSensorAlong) {
  EXPECT_GT(error_m(0.0), 1.0);
  EXPECT_LT(error_m(MatcherConfig{}.crowd_points), 0.05);
}

// A floor of each_way x each_way points in the root voxel that begins at x, seen by several rings.
void add_floor(float x, int each_way, std::vector<LocalPoint>& points) {
  for (int i = 0; i < each_way; ++i) {
    for (int k = 0; k < each_way; ++k) {
      const float step = 1.8f / static_cast<float>(each_way);
      points.push_back({x + 0.1f + step * static_cast<float>(i),
                        0.1f + step * static_cast<float>(k), 0.3f,
                        static_cast<std::uint16_t>(i % 3)});
    }
  }
}

TEST(Crowd, IsWhatFacesOneWayInOneRootVoxel) {
  VoxelPlaneMap map(testing::upright_grid());
  map.set_anchor(Eigen::Vector3d::Zero());
  std::vector<LocalPoint> points;
  add_floor(0.0f, 20, points);
  for (int i = 0; i < 10; ++i) {  // a wall above the first floor
    for (int k = 0; k < 10; ++k) {
      points.push_back({1.3f, 0.1f + 0.09f * static_cast<float>(i),
                        1.05f + 0.09f * static_cast<float>(k), static_cast<std::uint16_t>(k % 3)});
    }
  }
  add_floor(2.0f, 10, points);
  map.insert(points);
  std::vector<VoxelPlaneMap::Hint> hints(points.size());
  map.find_all(points, hints);
  const std::array<std::size_t, 4> ends{0, 400, 500, 600};
  for (std::size_t part = 0; part < 3; ++part) {
    const auto crowd = static_cast<float>(ends[part + 1] - ends[part]);
    for (std::size_t i = ends[part]; i < ends[part + 1]; ++i) {
      ASSERT_EQ(hints[i].match.crowd, crowd) << "point " << i;
    }
  }
  // The crowd stays that of the first look-up when the point moves to another voxel.
  const LocalPoint& p = points.front();
  EXPECT_EQ(map.find(Float4{p.x + 2.0f, p.y, p.z, 0.0f}, hints.front()).crowd, 400.0f);
}

}  // namespace
}  // namespace zloam::plane_map
