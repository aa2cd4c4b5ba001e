// What the platform's own motion says of a pose.

#include "integration/own_motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "integration/test_poses.hpp"

namespace zloam::integration {
namespace {

using test::along;

constexpr std::int64_t kPeriod_ns = 100'000'000;
const Matrix6 kMillimetre = 1e-6 * Matrix6::Identity();

/// Feeds steps along x from standing at 0, in a turn of yaw_deg; the last one's answer.
class Walk {
 public:
  explicit Walk(double yaw_deg = 0.0) : yaw_deg_(yaw_deg) { step(0.0); }

  Eigen::Vector3d step(double by_m, std::int64_t over_ns = kPeriod_ns) {
    x_m_ += by_m;
    at_ns_ += over_ns;
    return motion_.unexplained_m(at_ns_, along(x_m_, yaw_deg_), kMillimetre);
  }
  OwnMotion& motion() { return motion_; }

 private:
  OwnMotion motion_;
  double yaw_deg_;
  double x_m_ = 0.0;
  std::int64_t at_ns_ = 0;
};

TEST(OwnMotion, AStartFromRestExplainsItself) {
  Walk walk;
  for (int i = 0; i < 5; ++i) EXPECT_EQ(walk.step(0.002).norm(), 0.0) << i;
}

TEST(OwnMotion, AStartInMotionIsToldOnce) {
  Walk walk;
  EXPECT_NEAR(walk.step(0.5).x(), 0.5, 1e-12);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(walk.step(0.5).norm(), 0.0) << i;
}

TEST(OwnMotion, AStepWithoutExampleIsToldInThePosesAxes) {
  Walk walk(90.0);
  for (int i = 0; i < 10; ++i) walk.step(0.1 + 0.001 * (i % 2));
  const Eigen::Vector3d off_m = walk.step(0.4);
  EXPECT_NEAR(off_m.y(), -0.3, 0.002);
  EXPECT_NEAR(off_m.x(), 0.0, 1e-9);
}

TEST(OwnMotion, WhatItHasDoneBeforeItMayDoAgain) {
  Walk walk;
  walk.step(0.1);
  for (int i = 0; i < 20; ++i) walk.step(i % 2 == 0 ? 0.05 : 0.15);
  EXPECT_EQ(walk.step(0.05).norm(), 0.0);
  EXPECT_GT(walk.step(0.6).norm(), 0.5);
}

// The same accelerations have moved it a hundred times as far over a second.
TEST(OwnMotion, AGapLeavesTimeToAccelerate) {
  Walk walk;
  walk.step(0.1);
  for (int i = 0; i < 20; ++i) walk.step(i % 2 == 0 ? 0.09 : 0.11);
  EXPECT_EQ(walk.step(1.5, 10 * kPeriod_ns).norm(), 0.0);
}

TEST(OwnMotion, KnowsNothingOnceForgotten) {
  Walk walk;
  walk.step(0.1);
  walk.motion().forget_motion();
  EXPECT_EQ(walk.step(7.0).norm(), 0.0) << "the first pose after it";
  EXPECT_EQ(walk.step(0.9).norm(), 0.0) << "the first step after it";
  EXPECT_GT(walk.step(0.1).norm(), 0.5);
}

// A partial revolution, of which nothing matched, is not yet the beginning.
TEST(OwnMotion, ExpectsRestUntilAStepWasSeen) {
  for (const bool begun : {false, true}) {
    Walk walk;
    walk.motion().forget_motion();
    if (begun) walk.motion().begun_before();
    EXPECT_EQ(walk.step(0.5).norm(), 0.0) << "the first pose";
    EXPECT_NEAR(walk.step(0.5).norm(), begun ? 0.0 : 0.5, 1e-12);
  }
}

TEST(OwnMotion, AJumpIsToldOnce) {
  Walk walk;
  for (int i = 0; i < 10; ++i) walk.step(0.1);
  EXPECT_GT(walk.step(3.0).norm(), 2.5);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(walk.step(0.1).norm(), 0.0) << i;
  EXPECT_GT(walk.step(0.6).norm(), 0.4) << "a later error";
}

TEST(OwnMotion, AStartAtFullSpeedIsToldOnce) {
  Walk walk;
  EXPECT_NEAR(walk.step(3.0).x(), 3.0, 1e-12);
  for (int i = 0; i < 5; ++i) EXPECT_EQ(walk.step(3.0).norm(), 0.0) << i;
}

// Two poses of one instant, and one that is no number, are no motion.
TEST(OwnMotion, HoldsBesidePosesThatAreNone) {
  Walk walk;
  walk.step(0.1);
  EXPECT_EQ(walk.step(0.3, 0).norm(), 0.0);
  EXPECT_EQ(walk.step(std::numeric_limits<double>::quiet_NaN()).norm(), 0.0);
}

}  // namespace
}  // namespace zloam::integration
