#include "integration/step_fusion.hpp"

#include <gtest/gtest.h>

namespace zloam::integration {
namespace {

constexpr double kPeriod_s = 0.1;

Pose forward(double x_m) { return pose_from_xyz_rpy_deg({x_m, 0.0, 0.0}, {0.0, 0.0, 0.0}); }

double off_m(const StepFusion& fusion, const Pose& odometry_step, const Weak& weak) {
  const Pose step = fusion.step(odometry_step, weak, kPeriod_s, kPeriod_s);
  return (step.translation() - forward(0.8).translation()).norm();
}

// Started at 8 m/s between walls that do not tell the speed, an odometry takes a second to find it.
TEST(StepFusion, AnOdometryThatIsFarOffIsLearntOfAtOnce) {
  Weak weak;
  weak.degenerate = true;
  weak.translation = Eigen::Vector3d::UnitX();
  weak.sigma_measured = 0.01;
  const Pose too_short = forward(0.66);
  StepFusion fusion;
  fusion.observe(forward(0.8), too_short, kPeriod_s, 1);
  EXPECT_LT(off_m(fusion, too_short, weak), 0.05);
  for (int i = 0; i < 3; ++i) fusion.observe(forward(0.8), too_short, kPeriod_s, 1);
  EXPECT_LT(off_m(fusion, too_short, weak), 0.01);
}

TEST(StepFusion, OneWhoseStepsAreGoodLeads) {
  StepFusion fusion;
  for (int i = 0; i < 8; ++i) {
    fusion.observe(forward(i % 2 == 0 ? 0.82 : 0.78), forward(i % 2 == 0 ? 0.82 : 0.78), kPeriod_s,
                   1);
  }
  EXPECT_LT(off_m(fusion, forward(0.8), Weak{}), 0.001);
}

}  // namespace
}  // namespace zloam::integration
