// Unreachable poses are refused; if they keep coming and are consistent, they are accepted.

#include "common/geometry/motion_check.hpp"

#include <gtest/gtest.h>

namespace zloam {
namespace {

constexpr std::int64_t kPeriod_ns = 100'000'000;

Pose at_m(double x, double yaw_rad = 0.0) {
  Pose pose = Pose::Identity();
  pose.translate(Eigen::Vector3d(x, 0, 0));
  pose.rotate(Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()));
  return pose;
}

TEST(MotionCheck, FollowsAnythingThatMoves) {
  MotionCheck check;
  // A car at 60 m/s, then a platform that spins twice a second.
  for (int i = 0; i < 100; ++i) EXPECT_EQ(check.check(0, i * kPeriod_ns, at_m(6.0 * i)), "");
  for (int i = 0; i < 100; ++i) {
    EXPECT_EQ(check.check(0, (100 + i) * kPeriod_ns, at_m(594.0, 1.26 * i)), "");
  }
  // A second without a pose.
  EXPECT_EQ(check.check(0, 210 * kPeriod_ns, at_m(654.0)), "");
}

TEST(MotionCheck, RefusesWhatNoneCanReachAndKeepsTheLastOne) {
  MotionCheck check;
  EXPECT_EQ(check.check(0, 0, at_m(0.0)), "");
  for (const double wild : {20.0, -1000.0, 1e9, 1e300}) {
    EXPECT_NE(check.check(0, kPeriod_ns, at_m(wild)), "") << wild;
  }
  EXPECT_NE(check.check(0, kPeriod_ns / 10, at_m(0.0, 3.0)), "");
  EXPECT_NE(check.check(0, std::int64_t{1} << 62, at_m(0.0)), "");
  EXPECT_NE(check.check(0, -(std::int64_t{1} << 62), at_m(0.0)), "");
  EXPECT_EQ(check.check(0, kPeriod_ns, at_m(1.0)), "");
}

TEST(MotionCheck, OneThatWasHeldUpIsTaken) {
  MotionCheck check;
  EXPECT_EQ(check.check(0, 0, at_m(0.0)), "");
  EXPECT_EQ(check.check(0, 20 * kPeriod_ns, at_m(60.0)), "");
  EXPECT_EQ(check.check(0, 10 * kPeriod_ns, at_m(30.0)), "");
  EXPECT_EQ(check.check(0, 21 * kPeriod_ns, at_m(63.0)), "");
}

TEST(MotionCheck, AStrangerBetweenTheTrueOnesIsNeverBelieved) {
  MotionCheck check;
  for (int i = 0; i < 1000; ++i) {
    EXPECT_EQ(check.check(0, i * kPeriod_ns, at_m(0.1 * i)), "");
    EXPECT_NE(check.check(0, i * kPeriod_ns, at_m(5000.0)), "");
  }
}

TEST(MotionCheck, WhatKeepsComingAndFitsItselfIsTakenUp) {
  MotionCheck check;
  EXPECT_EQ(check.check(0, 0, at_m(0.0)), "");
  int refused = 0;
  for (int i = 1; !check.check(0, i * kPeriod_ns, at_m(500.0 + 0.1 * i)).empty(); ++i) {
    ASSERT_LT(++refused, 100);
  }
  EXPECT_EQ(refused, 19);
  EXPECT_EQ(check.check(0, 21 * kPeriod_ns, at_m(502.0)), "");
  // Poses that jump about are not consistent with each other.
  for (int i = 0; i < 100; ++i) {
    EXPECT_NE(check.check(0, (22 + i) * kPeriod_ns, at_m(1e4 * (1 + i))), "");
  }
}

TEST(MotionCheck, AnotherFrameIsNotCompared) {
  MotionCheck check;
  EXPECT_EQ(check.check(0, 0, at_m(5000.0)), "");
  EXPECT_EQ(check.check(1, kPeriod_ns, at_m(0.0)), "");
}

TEST(MotionCheck, ATransformOfFramesIsComparedWhereTheRobotIs) {
  // Far from the origin of the odometry a small rotation of the frame moves it by much, and the
  // robot, where both agree, not at all.
  MotionCheck check({.m = 1.0, .m_per_s = 0.0, .rad = 0.5, .rad_per_s = 0.0});
  const Pose T_odom_base = at_m(1000.0);
  Pose turned = at_m(0.0, 0.1);
  turned.pretranslate(T_odom_base.translation() - turned * T_odom_base.translation());
  EXPECT_EQ(check.check(0, 0, Pose::Identity(), T_odom_base), "");
  EXPECT_EQ(check.check(0, 0, turned, T_odom_base), "");
  EXPECT_NE(check.check(0, 0, at_m(0.0, 0.1), T_odom_base), "");
}

}  // namespace
}  // namespace zloam
