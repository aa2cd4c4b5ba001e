#include "common/geometry/lanes.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "common/geometry/floor.hpp"

namespace zloam {
namespace {

TEST(Lanes, CrossProductAndSumAreEigens) {
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  for (int n = 0; n < 100; ++n) {
    const Eigen::Vector3f a(normal(random), normal(random), normal(random));
    const Eigen::Vector3f b(normal(random), normal(random), normal(random));
    const Eigen::Vector3f expected = a.cross(b);
    const Float4 zxy = cross_zxy(lanes_of(a), lanes_of(b));
    EXPECT_NEAR(zxy[0], expected.z(), 1e-5);
    EXPECT_NEAR(zxy[1], expected.x(), 1e-5);
    EXPECT_NEAR(zxy[2], expected.y(), 1e-5);
    EXPECT_EQ(zxy[3], 0.0f);
    EXPECT_NEAR(sum_of_lanes(lanes_of(a) * lanes_of(b)), a.dot(b), 1e-5);
  }
}

TEST(Lanes, MotionIsThePosesOwn) {
  Vector6 twist;
  twist << 1.0, -2.0, 0.5, 0.3, -0.2, 0.9;
  const Pose motion = exp_se3(twist);
  const Float4 moved = MotionLanes(motion)(4.0f, -5.0f, 6.0f);
  const Eigen::Vector3d expected = motion * Eigen::Vector3d(4.0, -5.0, 6.0);
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(moved[i], expected[i], 1e-5);
  EXPECT_EQ(moved[3], 0.0f);
}

TEST(Lanes, BelowNeedsEveryLane) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(all_below(Float4{0.4f, -0.4f, 0.0f, 0.0f}, 0.5f));
  for (int lane = 0; lane < 4; ++lane) {
    for (const float out : {0.5f, -0.5f, 7.0f, -7.0f, kNan}) {
      Float4 v{0.4f, -0.4f, 0.0f, 0.0f};
      v[lane] = out;
      EXPECT_FALSE(all_below(v, 0.5f)) << lane << ' ' << out;
    }
  }
}

TEST(Lanes, WithinHasItsLowerEndAndNeedsEveryLane) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(all_within(Double2{-8.0, 7.0}, Double2{0.0, -8.0}, 8.0));
  for (int lane = 0; lane < 4; ++lane) {
    for (const double out : {8.0, -9.0, 1e30, kNan}) {
      Double2 v[2] = {Double2{-8.0, 7.0}, Double2{0.0, -8.0}};
      v[lane / 2][lane % 2] = out;
      EXPECT_FALSE(all_within(v[0], v[1], 8.0)) << lane << ' ' << out;
    }
  }
}

TEST(Lanes, FloorIsStdFloorInEachLane) {
  for (const double x : {-2.0, -1.5, -0.25, 0.0, 0.75, 1.0, 3.999, 1e9 + 0.5, -1e9 - 0.5}) {
    const Double2 two = floor_of(Double2{x, -x});
    EXPECT_EQ(two[0], std::floor(x));
    EXPECT_EQ(two[1], std::floor(-x));
  }
  for (const float x : {-2.0f, -1.5f, -0.25f, 0.0f, 0.75f, 1.0f, 3.999f, 12345.5f, -12345.5f}) {
    const Int4 four = floor_to_int(Float4{x, -x, x + 0.5f, 1.0f});
    EXPECT_EQ(four[0], std::floor(x));
    EXPECT_EQ(four[1], std::floor(-x));
    EXPECT_EQ(four[2], std::floor(x + 0.5f));
    EXPECT_EQ(four[3], 1);
  }
}

TEST(Floor, IsStdFloor) {
  for (const double x : {-2.0, -1.5, -1.0, -0.25, -0.0, 0.0, 0.75, 1.0, 1e9 + 0.5, -1e9 - 0.5}) {
    EXPECT_EQ(floor_to<std::int64_t>(x), static_cast<std::int64_t>(std::floor(x))) << x;
    EXPECT_EQ(floor_to<int>(x), static_cast<int>(std::floor(x))) << x;
  }
  EXPECT_EQ(floor_to<int>(-0.5f), -1);
}

}  // namespace
}  // namespace zloam
