#include "odometry/voxel_sums.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::odometry {
namespace {

constexpr int kShift = 6;
constexpr std::int64_t kEdge = 1 << kShift;

using Whole = std::array<std::int64_t, 3>;

// Reference: sums of the points' offsets from a centre, one product after the other.
VoxelSums summed(const std::vector<Whole>& points, const Whole& centre) {
  VoxelSums out;
  for (const Whole& p : points) {
    const Whole o = {p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]};
    std::size_t k = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      out.sum[i] += o[i];
      for (std::size_t j = i; j < 3; ++j) out.square[k++] += o[i] * o[j];
    }
    ++out.count;
  }
  return out;
}

void expect_same(const VoxelSums& a, const VoxelSums& b) {
  EXPECT_EQ(a.sum, b.sum);
  EXPECT_EQ(a.square, b.square);
  EXPECT_EQ(a.count, b.count);
}

UnitPoint unit_point(const Whole& p) {
  return {Double2{double(p[0]), double(p[1])}, Double2{double(p[2]), 0.0}};
}

class VoxelSumsTest : public ::testing::Test {
 protected:
  // Random points in the voxel with this lower corner.
  std::vector<Whole> points_in(const Whole& corner, int count) {
    std::uniform_int_distribution<std::int64_t> within(0, kEdge - 1);
    std::vector<Whole> out;
    for (int i = 0; i < count; ++i) {
      out.push_back(
          {corner[0] + within(random_), corner[1] + within(random_), corner[2] + within(random_)});
    }
    return out;
  }

  std::mt19937 random_{7};
};

TEST_F(VoxelSumsTest, OfARunAreThoseOfItsPoints) {
  for (const Whole& cell : {Whole{0, 0, 0}, Whole{-1, 5, -7}, Whole{30000, -30000, 12345}}) {
    const Whole corner = {cell[0] * kEdge, cell[1] * kEdge, cell[2] * kEdge};
    const auto points = points_in(corner, 500);
    VoxelRun run(kShift);
    EXPECT_TRUE(run.empty());
    EXPECT_FALSE(run.holds(unit_point(points[0])));
    run.begin(unit_point(points[0]));
    for (const Whole& p : points) {
      EXPECT_TRUE(run.holds(unit_point(p)));
      run.add(unit_point(p));
    }
    for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(run.cell()[i], cell[i]);
    expect_same(run.sums(), summed(points, {corner[0] + kEdge / 2, corner[1] + kEdge / 2,
                                            corner[2] + kEdge / 2}));
  }
}

TEST_F(VoxelSumsTest, ARunEndsAtEachFaceOfItsVoxel) {
  VoxelRun run(kShift);
  run.begin(unit_point({-1, 0, 5}));
  for (std::size_t axis = 0; axis < 3; ++axis) {
    Whole low = {-kEdge, 0, 0}, high = {-1, kEdge - 1, kEdge - 1};
    EXPECT_TRUE(run.holds(unit_point(low)));
    EXPECT_TRUE(run.holds(unit_point(high)));
    --low[axis];
    ++high[axis];
    EXPECT_FALSE(run.holds(unit_point(low))) << axis;
    EXPECT_FALSE(run.holds(unit_point(high))) << axis;
  }
}

TEST_F(VoxelSumsTest, MovedAreThoseAboutTheOtherCentre) {
  const auto points = points_in({0, 0, 0}, 300);
  VoxelSums moved;
  moved.add_moved(summed(points, {32, 32, 32}), {-32, 32, -32});
  expect_same(moved, summed(points, {64, 0, 64}));
}

TEST_F(VoxelSumsTest, WhatIsTakenAwayLeavesTheRest) {
  const auto first = points_in({0, 0, 0}, 40), second = points_in({0, 0, 0}, 60);
  VoxelSums sums = summed(first, {32, 32, 32});
  sums.add<1>(summed(second, {32, 32, 32}));
  sums.add<-1>(summed(first, {32, 32, 32}));
  expect_same(sums, summed(second, {32, 32, 32}));
}

TEST_F(VoxelSumsTest, UnitsAreRoundedDownAndSaturate) {
  const Eigen::Matrix3d turn = 1000.0 * exp_so3({0.1, -0.4, 0.7});
  const Eigen::Vector3d shift(-3.5, 12.25, 1e6);
  const ToUnits to_units(turn, shift);
  std::uniform_real_distribution<float> coordinate(-200.0F, 200.0F);
  Point p{};
  for (int i = 0; i < 200; ++i) {
    p.x = coordinate(random_);
    p.y = coordinate(random_);
    p.z = coordinate(random_);
    const Eigen::Vector3d exact = turn * p.position().cast<double>() + shift;
    const UnitPoint unit = to_units(p);
    EXPECT_NEAR(unit.xy[0], std::floor(exact.x()), 1e-6);
    EXPECT_NEAR(unit.xy[1], std::floor(exact.y()), 1e-6);
    EXPECT_NEAR(unit.z[0], std::floor(exact.z()), 1e-6);
  }
  p = Point{};
  p.x = 1e8F;
  const UnitPoint far = ToUnits(1000.0 * Eigen::Matrix3d::Identity(), {0, 0, -1e12})(p);
  EXPECT_EQ(far.xy[0], kMostUnits);
  EXPECT_EQ(far.z[0], -kMostUnits);
}

}  // namespace
}  // namespace zloam::odometry
