#include "integration/step_fusion.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace zloam::integration {
namespace {

constexpr double kPeriod_s = 0.1;

Pose forward(double x_m) { return pose_from_xyz_rpy_deg({x_m, 0.0, 0.0}, {0.0, 0.0, 0.0}); }

const Matrix6 kExact = Matrix6::Zero();

double off_m(const StepFusion& fusion, const Pose& odometry_step, const Weak& weak) {
  const Pose step = fusion.step(odometry_step, weak, kPeriod_s, kPeriod_s);
  return (step.translation() - forward(0.8).translation()).norm();
}

// Started at 8 m/s between walls that do not constrain the speed, an odometry takes a second to
// find it.
TEST(StepFusion, AnOdometryThatIsFarOffIsLearntOfAtOnce) {
  Weak weak;
  weak.degenerate = true;
  weak.translation = Eigen::Vector3d::UnitX();
  weak.sigma_measured = 0.01;
  const Pose too_short = forward(0.66);
  StepFusion fusion;
  fusion.observe(forward(0.8), kExact, too_short, kPeriod_s, 1);
  EXPECT_LT(off_m(fusion, too_short, weak), 0.05);
  for (int i = 0; i < 3; ++i) fusion.observe(forward(0.8), kExact, too_short, kPeriod_s, 1);
  EXPECT_LT(off_m(fusion, too_short, weak), 0.01);
}

TEST(StepFusion, OneWhoseStepsAreGoodLeads) {
  StepFusion fusion;
  for (int i = 0; i < 8; ++i) {
    const Pose step = forward(i % 2 == 0 ? 0.82 : 0.78);
    fusion.observe(step, kExact, step, kPeriod_s, 1);
  }
  EXPECT_LT(off_m(fusion, forward(0.8), Weak{}), 0.001);
}

// Sigma along x after steps that neither source predicts, with mapped poses known to 1 cm.
double sigma_after_m(double off_m) {
  StepFusion fusion;
  for (int i = 0; i < 60; ++i) {
    const double sign = i % 4 < 2 ? 1.0 : -1.0;
    fusion.observe(forward(0.8 + sign * off_m), 1e-4 * Matrix6::Identity(), forward(0.8), kPeriod_s,
                   1);
  }
  return std::sqrt(fusion.covariance(kPeriod_s).value()(0, 0));
}

TEST(StepFusion, TheCovarianceIsWhatTheMappedPosesDoNotExplain) {
  EXPECT_LT(sigma_after_m(0.005), 0.002);
  EXPECT_NEAR(sigma_after_m(0.1), 0.1, 0.02);
  EXPECT_FALSE(StepFusion().covariance(kPeriod_s));
}

TEST(StepFusion, TheFirstErrorIsToldAtOnce) {
  StepFusion fusion;
  fusion.observe(forward(0.6), 1e-6 * Matrix6::Identity(), forward(0.8), kPeriod_s, 1);
  EXPECT_GT(std::sqrt(fusion.covariance(kPeriod_s).value()(0, 0)), 0.1);
}

// Without the map's motion the steps are the odometry's, with its errors.
TEST(StepFusion, WhereTheOdometryIsAloneItsErrorsCount) {
  StepFusion fusion;
  for (int i = 0; i < 60; ++i) fusion.observe(forward(0.8), kExact, forward(0.7), kPeriod_s, 1);
  EXPECT_LT(std::sqrt(fusion.covariance(0.3).value()(0, 0)), 0.01);
  EXPECT_NEAR(std::sqrt(fusion.covariance(0.6).value()(0, 0)), 0.1, 0.01);
}

TEST(StepFusion, AStepThatNoErrorSoFarExplainsIsAContradiction) {
  StepFusion fusion;
  const Matrix6 mapped = 1e-4 * Matrix6::Identity();
  for (int i = 0; i < 20; ++i) {
    fusion.observe(forward(i % 2 == 0 ? 0.81 : 0.79), mapped, forward(0.8), kPeriod_s, 1);
  }
  const auto off_m = [&](double mapped_m, int sweeps) {
    return fusion.contradiction_m(forward(mapped_m), mapped, forward(0.8), sweeps).x();
  };
  EXPECT_EQ(off_m(0.83, 1), 0.0);
  EXPECT_NEAR(off_m(0.9, 1), 0.1, 1e-12);
  // Over ten sweeps it may have been off by ten times as much.
  EXPECT_EQ(off_m(0.9, 10), 0.0);
  EXPECT_NEAR(off_m(0.3, 1), -0.5, 1e-12);
  EXPECT_EQ(off_m(std::nan(""), 1), 0.0);
}

}  // namespace
}  // namespace zloam::integration
