// The covariance of the fused pose.

#include <gtest/gtest.h>

#include <cmath>
#include <utility>
#include <vector>

#include "integration/integration.hpp"
#include "integration/test_poses.hpp"

namespace zloam::integration {
namespace {

using test::along;
using test::correction;
using test::odometry;

// The pose in a new frame is that of the last one and a guess of the motion in between: not the
// millimetres of one step.
TEST(FusedCovariance, AGuessAcrossAGapIsUncertainByIt) {
  Integrator integrator{IntegrationConfig{}};
  integrator.add(odometry(0, false));
  integrator.add(odometry(1, false));
  integrator.add(correction(1, along(1.0)));
  integrator.add(odometry(2, false));
  const auto before = integrator.add(odometry(3, false)).at(0);
  OdometryPose restarted = odometry(23, false, 1);
  restarted.T_odom_base = Pose::Identity();
  const auto bridged = integrator.add(restarted).at(0);
  // Two seconds at an acceleration of 2 m/s^2.
  EXPECT_NEAR(std::sqrt(bridged.covariance(0, 0)), 4.0, 0.01);
  EXPECT_GT(bridged.covariance(0, 0), before.covariance(0, 0) + 16.0);
  EXPECT_NEAR(std::sqrt(bridged.covariance(5, 5)), 0.6, 0.01);
  restarted.sweep = 24;
  EXPECT_GE(integrator.add(restarted).at(0).covariance(0, 0), bridged.covariance(0, 0))
      << "until a correction comes";
}

TEST(FusedCovariance, GrowsWithTheOdometrySinceTheCorrection) {
  Integrator integrator{IntegrationConfig{}};
  integrator.add(odometry(0, false));
  integrator.add(odometry(1, false));
  integrator.add(correction(1, Pose::Identity()));
  const auto one = integrator.add(odometry(2, false)).at(0);
  const double step_m = IntegrationConfig{}.step_scale_m;
  const double step = step_m * step_m * 1e-4;
  // Along x the rotation error has no effect: 4e-4 of the correction plus the steps.
  EXPECT_NEAR(one.covariance(0, 0), 4e-4 + step, 1e-12);
  // Across, the correction's rotation error acts over the 0.5 m driven since.
  EXPECT_NEAR(one.covariance(1, 1), 4e-4 + step + 0.25 * 4e-4, 1e-12);
  const auto two = integrator.add(odometry(3, false)).at(0);
  EXPECT_NEAR(two.covariance(0, 0), 4e-4 + 2.0 * step, 1e-12);
  integrator.add(correction(3, Pose::Identity()));
  EXPECT_NEAR(integrator.add(odometry(4, false)).at(0).covariance(0, 0), 4e-4 + step, 1e-12);
}

// The odometry was right to a millimetre for 20 sweeps; then the map puts a sweep off_m beside it,
// and the next ones as well. Returns the fused poses from the one based on that sweep on. `before`:
// health of the correction before that sweep.
std::vector<FusedPose> after_a_contradiction(double off_m, double wobble_m,
                                             Health before = Health::kOk) {
  Integrator integrator{IntegrationConfig{}};
  std::vector<FusedPose> fused;
  for (std::uint64_t n = 0; n < 24; ++n) {
    OdometryPose pose = odometry(n, true);
    pose.T_odom_base = along(0.5 * static_cast<double>(n), 90.0);
    for (const FusedPose& each : integrator.add(pose)) {
      if (n > 20) fused.push_back(each);
    }
    Pose T_map_odom = Pose::Identity();
    T_map_odom.translation().y() = (n % 2 == 0 ? 0.5 : -0.5) * wobble_m;
    if (n >= 20) T_map_odom.translation().y() += off_m;
    Correction mapped = correction(n, T_map_odom);
    if (n == 19) mapped.health = before;
    integrator.add(mapped);
  }
  return fused;
}

TEST(FusedCovariance, HoldsWhereTheMapContradictsTheOdometry) {
  const std::vector<FusedPose> fused = after_a_contradiction(0.5, 0.002);
  ASSERT_GE(fused.size(), 2U);
  // Across the way, which is the robot's own x axis: it faces along the map's y axis.
  EXPECT_NEAR(std::sqrt(fused[0].covariance(0, 0)), 0.5, 0.02);
  EXPECT_LT(std::sqrt(fused[0].covariance(1, 1)), 0.05);
  EXPECT_EQ(fused[0].health, Health::kDegenerate);
  EXPECT_NEAR(std::abs(fused[0].weak.translation.x()), 1.0, 0.01);
  // From there on both agree; the record of the steps' errors has the one.
  EXPECT_LT(std::sqrt(fused[1].covariance(0, 0)), 0.2);
}

// Its step to the first pose that is measured again has the odometry's error of the time between.
TEST(FusedCovariance, APoseThatTheMapDidNotMeasureContradictsNothing) {
  for (const Health before : {Health::kPredicted, Health::kLost}) {
    const std::vector<FusedPose> fused = after_a_contradiction(0.5, 0.002, before);
    ASSERT_FALSE(fused.empty());
    EXPECT_LT(std::sqrt(fused[0].covariance(0, 0)), 0.1);
    EXPECT_EQ(fused[0].health, Health::kOk);
  }
}

TEST(FusedCovariance, AnOdometryThatIsOftenOffContradictsNothing) {
  for (const auto& [off_m, wobble_m] : {std::pair(0.5, 0.5), {0.05, 0.002}}) {
    const std::vector<FusedPose> fused = after_a_contradiction(off_m, wobble_m);
    ASSERT_FALSE(fused.empty());
    EXPECT_LT(std::sqrt(fused[0].covariance(0, 0)), off_m + 0.5 * wobble_m) << off_m;
  }
}

}  // namespace
}  // namespace zloam::integration
