#include "odometry/imu_integration.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "common/geometry/inertial_step.hpp"
#include "odometry/test_inertia.hpp"

namespace zloam::odometry {
namespace {

constexpr std::int64_t kOrigin_ns = 1'700'000'000'000'000'000;
constexpr std::uint32_t kPeriod_ns = 100'000'000;
const Eigen::Vector3d kGravity{0.0, 0.0, -9.80665};

std::optional<SweepInertia> over(const std::vector<ImuReading>& readings, double begin_s,
                                 const Pose& T_base_imu = Pose::Identity()) {
  return integrate(readings, kOrigin_ns + std::llround(1e9 * begin_s), kPeriod_ns, T_base_imu, {});
}

Eigen::Vector3d mean_velocity(const Motion& motion, double begin_s) {
  return 10.0 * (motion(begin_s + 0.1).translation() - motion(begin_s).translation());
}

// Both integrals and gravity add up to the change of the mean velocity from one sweep to the next,
// and the rotation is that of the motion, wherever the IMU is mounted.
TEST(ImuIntegration, GivesTurnAndChangeOfVelocityOfASwingingPlatform) {
  const Pose mountings[] = {Pose::Identity(),
                            pose_from_xyz_rpy_deg({0.3, -0.2, 0.4}, {0.0, 0.0, 0.0}),
                            pose_from_xyz_rpy_deg({-0.2, 0.1, 0.3}, {170.0, 20.0, -80.0})};
  for (const Pose& mounting : mountings) {
    TestImu imu;
    imu.T_base_imu = mounting;
    imu.rate_hz = 1000.0;
    const auto readings = readings_along(swinging, imu, 0.0, 3.0, kOrigin_ns);
    for (double begin_s = 0.2; begin_s < 2.5; begin_s += 0.3) {
      const auto before = over(readings, begin_s - 0.1, mounting);
      const auto now = over(readings, begin_s, mounting);
      ASSERT_TRUE(before && now);
      const Pose at = swinging(begin_s);
      const Eigen::Vector3d change =
          at.linear() * (before->mean_to_end_mps + now->begin_to_mean_mps) + 0.1 * kGravity;
      const Eigen::Vector3d truth =
          mean_velocity(swinging, begin_s) - mean_velocity(swinging, begin_s - 0.1);
      EXPECT_LT((change - truth).norm(), 2e-4) << "begin " << begin_s;
      const Eigen::Vector3d turn =
          log_so3(at.linear().transpose() * swinging(begin_s + 0.1).linear());
      EXPECT_LT((now->turn_rad - turn).norm(), 2e-6) << "begin " << begin_s;
    }
  }
}

TEST(ImuIntegration, GivesTheChangeOfTheTurnsRateWithinASweep) {
  const Motion speeding_up = [](double t) {
    Pose at = Pose::Identity();
    at.linear() = exp_so3({0.0, 0.0, 0.5 * t + 0.5 * 3.0 * t * t});
    return at;
  };
  TestImu imu;
  imu.rate_hz = 1000.0;
  const auto found = over(readings_along(speeding_up, imu, 0.0, 1.0, kOrigin_ns), 0.4);
  ASSERT_TRUE(found);
  // 3 rad/s^2 change the rate by 0.3 rad/s within a sweep: 0.03 rad per sweep.
  EXPECT_LT((found->bend_rad - Eigen::Vector3d(0.0, 0.0, 0.03)).norm(), 1e-5);
}

TEST(ImuIntegration, TakesBiasesOff) {
  TestImu imu;
  imu.force_bias_mps2 << 0.1, -0.2, 0.3;
  imu.rate_bias_radps << 0.02, 0.01, -0.03;
  TestImu ideal;
  const auto biased = readings_along(swinging, imu, 0.0, 1.0, kOrigin_ns);
  const auto unbiased = readings_along(swinging, ideal, 0.0, 1.0, kOrigin_ns);
  const std::int64_t stamp_ns = kOrigin_ns + 300'000'000;
  const auto a = integrate(biased, stamp_ns, kPeriod_ns, Pose::Identity(),
                           {imu.force_bias_mps2, imu.rate_bias_radps});
  const auto b = integrate(unbiased, stamp_ns, kPeriod_ns, Pose::Identity(), {});
  ASSERT_TRUE(a && b);
  EXPECT_LT((a->turn_rad - b->turn_rad).norm(), 1e-12);
  EXPECT_LT((a->mean_to_end_mps - b->mean_to_end_mps).norm(), 1e-12);
}

TEST(ImuIntegration, SaysNothingOfASweepThatIsNotCovered) {
  auto readings = readings_along(swinging, {}, 0.0, 1.0, kOrigin_ns);
  EXPECT_TRUE(over(readings, 0.5));
  EXPECT_FALSE(over(readings, 0.95));
  EXPECT_FALSE(over(readings, -0.1));
  EXPECT_FALSE(over({}, 0.5));
  EXPECT_FALSE(integrate(readings, kOrigin_ns + 500'000'000, 0, Pose::Identity(), {}));
  // Six readings (30 ms) are missing.
  std::erase_if(readings, [](const ImuReading& r) {
    const std::int64_t t_ms = (r.stamp_ns - kOrigin_ns) / 1'000'000;
    return t_ms > 520 && t_ms <= 550;
  });
  EXPECT_FALSE(over(readings, 0.5));
  EXPECT_TRUE(over(readings, 0.6));
}

TEST(ImuIntegration, PassesOverWhatIsOutOfOrderOrNotFinite) {
  const auto readings = readings_along(swinging, {}, 0.0, 1.0, kOrigin_ns);
  auto spoilt = readings;
  spoilt.insert(spoilt.begin() + 110, spoilt[100]);
  ImuReading nan = spoilt[120];
  nan.stamp_ns += 1'000'000;
  nan.rate_radps.x() = std::numeric_limits<double>::quiet_NaN();
  spoilt.insert(spoilt.begin() + 121, nan);
  const auto a = over(spoilt, 0.5), b = over(readings, 0.5);
  ASSERT_TRUE(a && b);
  EXPECT_EQ(a->turn_rad, b->turn_rad);
  EXPECT_EQ(a->begin_to_mean_mps, b->begin_to_mean_mps);
}

// twist_after() with the true step gives the true twist, whatever the twist before was.
TEST(InertialStep, GivesTheTwistAfter) {
  for (double begin_s = 0.2; begin_s < 2.5; begin_s += 0.3) {
    const Pose T_begin = swinging(begin_s);
    const Vector6 before = log_se3(swinging(begin_s - 0.1).inverse() * T_begin);
    const Vector6 truth = log_se3(T_begin.inverse() * swinging(begin_s + 0.05));
    InertialStep step;
    step.turn_rad = truth.tail<3>();
    // The second sweep is half as long.
    const Eigen::Vector3d now =
        20.0 * (swinging(begin_s + 0.05).translation() - T_begin.translation());
    step.velocity_change_mps =
        T_begin.linear().transpose() * (now - mean_velocity(swinging, begin_s - 0.1));
    EXPECT_LT((twist_after(step, before, 0.1, 0.05) - truth).norm(), 1e-12);
  }
}

TEST(InertialStep, ItsJacobianIsThatOfSmallChanges) {
  InertialStep step;
  step.turn_rad << 0.05, -0.1, 0.15;
  step.velocity_change_mps << 0.3, -0.2, 0.1;
  Vector6 before;
  before << 0.4, -0.1, 0.05, 0.03, -0.06, 0.1;
  const Matrix6 jacobian = twist_after_jacobian(step, before, 0.1, 0.05);
  for (int i = 0; i < 6; ++i) {
    constexpr double kStep = 1e-6;
    const Vector6 up = twist_after(step, before + kStep * Vector6::Unit(i), 0.1, 0.05);
    const Vector6 down = twist_after(step, before - kStep * Vector6::Unit(i), 0.1, 0.05);
    // The derivative by the rotation is of first order only.
    EXPECT_LT((jacobian.col(i) - (up - down) / (2.0 * kStep)).norm(), i < 3 ? 1e-8 : 0.01) << i;
  }
}

}  // namespace
}  // namespace zloam::odometry
