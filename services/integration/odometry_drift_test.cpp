// Odometry and map over the last ten metres.

#include "integration/odometry_drift.hpp"

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "common/geometry/state_bits.hpp"
#include "integration/integration.hpp"
#include "integration/test_poses.hpp"

namespace zloam::integration {
namespace {

constexpr double kStep_m = 0.1, kLimit_m = 0.1;

Pose at(double x_m, double yaw_deg = 0.0) {
  return pose_from_xyz_rpy_deg({x_m, 0.0, 0.0}, {0.0, 0.0, yaw_deg});
}

/// Poses every 0.1 m, of which the odometry measures so much, and ahead_m more in all, in a frame
/// that is turned.
void drive(OdometryDrift& drift, double from_m, double to_m, double factor, double sigma_m = 0.001,
           double ahead_m = 0.0) {
  for (double x_m = from_m; x_m < to_m + 0.5 * kStep_m; x_m += kStep_m) {
    drift.add(at(x_m), at(0.0, 30.0) * at(factor * x_m + ahead_m),
              sigma_m * sigma_m * Eigen::Matrix3d::Identity());
  }
}

TEST(OdometryDrift, IsTheDifferenceOverTheLastTenMetres) {
  OdometryDrift drift;
  drive(drift, 0.0, 50.0, 1.005);
  EXPECT_NEAR(drift.drift_m(), 0.05, 0.003);
  EXPECT_NEAR(drift.way_m(), 10.0, 0.51);
  EXPECT_FALSE(drift.exceeds(kLimit_m));
}

TEST(OdometryDrift, OfAnOdometryThatStaysBehindIsToldAtOnce) {
  OdometryDrift drift;
  drive(drift, 0.0, 0.1, 0.0);
  EXPECT_FALSE(drift.exceeds(kLimit_m));
  drive(drift, 0.2, 0.2, 0.0);
  EXPECT_TRUE(drift.exceeds(kLimit_m));
  EXPECT_NEAR(drift.drift_m(), 0.2, 1e-9);
}

TEST(OdometryDrift, OfAnOdometryThatRunsAwayFromAStandingMapIsTold) {
  OdometryDrift drift;
  for (int i = 0; i < 100; ++i) {
    drift.add(at(0.0), at(0.01 * i), 1e-6 * Eigen::Matrix3d::Identity());
  }
  EXPECT_TRUE(drift.exceeds(kLimit_m));
  EXPECT_NEAR(drift.drift_m(), 0.99, 1e-9);
}

TEST(OdometryDrift, ThatAnUncertainMapExplainsIsNotTold) {
  OdometryDrift drift;
  drive(drift, 0.0, 20.0, 1.02, 0.1);
  EXPECT_NEAR(drift.drift_m(), 0.2, 0.011);
  EXPECT_FALSE(drift.exceeds(kLimit_m));
}

TEST(OdometryDrift, EndsWhenTheOdometryIsRightAgain) {
  OdometryDrift drift;
  drive(drift, 0.0, 5.0, 1.5);
  EXPECT_TRUE(drift.exceeds(kLimit_m));
  drive(drift, 5.1, 16.0, 1.0, 0.001, 2.5);
  EXPECT_FALSE(drift.exceeds(kLimit_m));
}

TEST(OdometryDrift, ForgetsPosesThatNoOtherFollows) {
  OdometryDrift drift;
  drive(drift, 0.0, 5.0, 1.5);
  drift.forget();
  drift.add(at(100.0), at(0.0), Eigen::Matrix3d::Zero());
  EXPECT_EQ(drift.drift_m(), 0.0);
  EXPECT_FALSE(drift.exceeds(kLimit_m));
}

TEST(OdometryDrift, GoesOnFromItsState) {
  OdometryDrift whole, second;
  drive(whole, 0.0, 12.0, 1.02);
  StateBits bits;
  whole.each(bits);
  const std::vector<std::uint64_t> state = bits.take();
  StateBits back(state);
  second.each(back);
  ASSERT_TRUE(back.complete());
  drive(whole, 12.1, 15.0, 1.02);
  drive(second, 12.1, 15.0, 1.02);
  EXPECT_EQ(whole.drift_m(), second.drift_m());
  EXPECT_EQ(whole.way_m(), second.way_m());
}

/// Drives on live to this sweep; the map measures the odometry's steps, and this much more.
FusedPose go_on(Integrator& integrator, std::uint64_t from, std::uint64_t to, double more_m,
                const Correction& like) {
  FusedPose last;
  for (std::uint64_t sweep = from; sweep <= to; ++sweep) {
    Correction c = like;
    c.sweep = sweep;
    c.T_map_odom = test::along(more_m * static_cast<double>(sweep));
    integrator.add(c);
    for (const FusedPose& pose : integrator.add(test::odometry(sweep, false))) last = pose;
  }
  return last;
}

Correction sure_correction() {
  Correction c = test::correction(0, Pose::Identity());
  c.covariance = 1e-6 * Matrix6::Identity();
  return c;
}

TEST(OdometryDriftOfAPose, IsToldWhereTheMapGoesFarther) {
  Integrator integrator{IntegrationConfig{}};
  // 0.5 m a sweep: at 10 m 0.06 m, then 0.4 m.
  EXPECT_FALSE(go_on(integrator, 0, 40, 0.003, sure_correction()).odometry_drifts);
  Integrator second{IntegrationConfig{}};
  const FusedPose pose = go_on(second, 0, 40, 0.02, sure_correction());
  EXPECT_TRUE(pose.odometry_drifts);
  EXPECT_NEAR(pose.odometry_drift_m, 0.4, 0.03);
  EXPECT_NEAR(pose.odometry_way_m, 10.0, 0.6);
}

TEST(OdometryDriftOfAPose, BeginsAnewInAnotherMapAndAfterAPoseThatTheMapDidNotMatch) {
  Correction another = sure_correction();
  another.map_id = 7;
  Correction lost = sure_correction();
  lost.health = Health::kLost;
  for (const Correction& next : {another, lost}) {
    Integrator integrator{IntegrationConfig{}};
    ASSERT_TRUE(go_on(integrator, 0, 40, 0.02, sure_correction()).odometry_drifts);
    EXPECT_FALSE(go_on(integrator, 41, 41, 0.02, next).odometry_drifts);
  }
}

TEST(OdometryDriftOfAPose, IsNotMeasuredWhereTheMapLeavesADirectionOpen) {
  Correction open = sure_correction();
  open.weak.degenerate = true;
  Integrator integrator{IntegrationConfig{}};
  EXPECT_EQ(go_on(integrator, 0, 40, 0.02, open).odometry_drift_m, 0.0);
}

}  // namespace
}  // namespace zloam::integration
