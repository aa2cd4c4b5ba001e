// Odometry with an IMU: what it gains, what a wrong IMU costs, and what is restored.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <numbers>

#include "odometry/inertial_aid.hpp"
#include "odometry/test_inertia.hpp"

namespace zloam::odometry {
namespace {

constexpr std::int64_t kStart_ns = 1'000'000'000'000;

struct Ride {
  std::vector<OdometryResult> results;
  std::vector<Pose> truth_end;
  double worst_step_m = 0.0;
  double end_error_m = 0.0;
};

// A sweep as the odometry takes it; points and readings must outlive it.
struct SweepData {
  PointVector points;
  std::vector<ImuReading> readings;

  FeatureSweep features(int k, const TestSensor& sensor) const {
    FeatureSweep sweep;
    sweep.sweep = static_cast<std::uint64_t>(k);
    sweep.stamp_ns = kStart_ns + static_cast<std::int64_t>(k) * sensor.period_ns;
    sweep.period_ns = sensor.period_ns;
    sweep.range_noise_m = std::max(0.01, sensor.noise_m);
    sweep.less_flat = points;
    sweep.imu = readings;
    return sweep;
  }
};

SweepData sweep_data(const TestWorld& world, const TestSensor& sensor, const Motion& motion,
                     const std::optional<TestImu>& imu, int k) {
  const double begin_s = 0.1 * k;
  SweepData data;
  data.points = sweep_along(world, sensor, motion, begin_s, 100U + unsigned(k));
  if (imu) {
    data.readings = readings_along(motion, *imu, begin_s - 0.03 - imu->delay_s,
                                   begin_s + 0.13 - imu->delay_s, kStart_ns);
  }
  return data;
}

Ride ride(const TestWorld& world, const Motion& motion, const std::optional<TestImu>& imu,
          int sweeps, const Pose& T_base_imu) {
  const TestSensor sensor{.noise_m = 0.02};
  Ride out;
  Odometry odometry({}, sensor.T_base_lidar, T_base_imu);
  for (int k = 0; k < sweeps; ++k) {
    const SweepData data = sweep_data(world, sensor, motion, imu, k);
    out.results.push_back(odometry.process(data.features(k, sensor)));
    out.truth_end.push_back(motion(0.1).inverse() * motion(0.1 * (k + 1)));
    const auto n = out.results.size();
    if (n < 2) continue;
    const Pose ours = out.results[n - 2].T_odom_base.inverse() * out.results[n - 1].T_odom_base;
    const Pose truth = out.truth_end[n - 2].inverse() * out.truth_end[n - 1];
    const double off_m = (ours.translation() - truth.translation()).norm();
    out.worst_step_m = std::max(out.worst_step_m, off_m);
  }
  out.end_error_m =
      (out.truth_end.back().inverse() * out.results.back().T_odom_base).translation().norm();
  return out;
}

Ride ride(const TestWorld& world, const Motion& motion, const std::optional<TestImu>& imu,
          int sweeps) {
  return ride(world, motion, imu, sweeps, imu ? imu->T_base_imu : Pose::Identity());
}

// An endless smooth tunnel without any surface across it.
const TestWorld kTunnel{{{-500.0, -2.0, -1.2}, {500.0, 2.1, 2.0}}, {}};

// At rest for a second, then nodding and accelerating to 3 m/s within two seconds.
Pose through_the_tunnel(double t) {
  const double s = std::max(0.0, t - 1.0);
  const double way_m = s < 2.0 ? 0.75 * s * s : 3.0 + 3.0 * (s - 2.0);
  const double nod_rad = 0.008 * (1.0 - std::cos(6.0 * s));
  Pose at = Pose::Identity();
  at.linear() = exp_so3({0.0, nod_rad, 0.0});
  at.translation() << way_m, 0.0, 0.01 * (1.0 - std::cos(5.0 * s));
  return at;
}

TestImu mems() {
  TestImu imu;
  imu.force_bias_mps2 << 0.02, -0.03, 0.015;
  imu.rate_bias_radps << 0.003, -0.002, 0.004;
  imu.force_noise_mps2 = 0.0085;
  imu.rate_noise_radps = 0.007;
  return imu;
}

TEST(OdometryWithImu, KnowsTheWayThroughABareTunnelFromRest) {
  constexpr int kSweeps = 60;
  const Ride without = ride(kTunnel, through_the_tunnel, std::nullopt, kSweeps);
  EXPECT_GT(without.end_error_m, 3.0) << "something faces along the tunnel: the test is too easy";
  const Ride with = ride(kTunnel, through_the_tunnel, mems(), kSweeps);
  EXPECT_LT(with.end_error_m, 0.15);
  EXPECT_LT(with.worst_step_m, 0.02);
  // Known from the IMU only: Degenerate is still reported once the platform moves. At rest the
  // traces of the rings constrain the axis.
  constexpr int kMoving = 12;
  for (int k = kMoving; k < kSweeps; ++k) {
    const Degeneracy& d = with.results[std::size_t(k)].degeneracy;
    EXPECT_TRUE(d.degenerate && std::abs(d.weak_translation.x()) > 0.98) << k;
  }
}

double rms_rotation_error_rad(const Ride& r, std::size_t from) {
  double sum = 0.0;
  for (std::size_t k = from; k < r.results.size(); ++k) {
    const Pose off = r.truth_end[k].inverse() * r.results[k].T_odom_base;
    sum += log_so3(off.linear()).squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(r.results.size() - from));
}

constexpr double kPace = 1.2;

// At rest for a second, then the motion of swinging().
Pose swings_after_a_second(double t) {
  const double s = std::max(0.0, t - 1.0);
  // Starts smoothly.
  const double ease = s * s / (s + 0.5);
  return swinging(0.0).inverse() * swinging(kPace * ease);
}

TEST(OdometryWithImu, TurnsThatChangeWithinASweepAreMeasured) {
  const Ride without = ride({}, swings_after_a_second, std::nullopt, 40);
  const Ride with = ride({}, swings_after_a_second, mems(), 40);
  EXPECT_LT(rms_rotation_error_rad(with, 12), 0.5 * rms_rotation_error_rad(without, 12));
  EXPECT_LT(rms_rotation_error_rad(with, 12), 0.0015);
}

TEST(OdometryWithImu, ASensorBesideTheOriginAndTurnedIsAsGood) {
  TestImu imu = mems();
  imu.T_base_imu = pose_from_xyz_rpy_deg({0.3, -0.2, 0.25}, {180.0, 0.0, 90.0});
  const Ride r = ride({}, swings_after_a_second, imu, 40);
  EXPECT_LT(rms_rotation_error_rad(r, 12), 0.0015);
  EXPECT_LT(r.end_error_m, 0.02);
}

// The biases are estimated: the remaining errors are far smaller than they.
TEST(OdometryWithImu, FindsTheBiases) {
  TestImu imu = mems();
  imu.rate_bias_radps << 0.02, -0.015, 0.025;
  const Ride r = ride({}, swings_after_a_second, imu, 60);
  ASSERT_TRUE(r.results.back().inertia);
  const ImuErrors found = r.results.back().inertia->errors();
  EXPECT_LT((found.rate_radps - imu.rate_bias_radps).norm(), 0.002);
}

// A delay of the stamps, late or early, is estimated and costs almost no accuracy.
TEST(OdometryWithImu, FindsTheDelayOfTheStamps) {
  for (const double delay_s : {0.0, 0.02, -0.015}) {
    TestImu imu = mems();
    imu.delay_s = delay_s;
    const Ride r = ride({}, swings_after_a_second, imu, 60);
    ASSERT_TRUE(r.results.back().inertia);
    EXPECT_NEAR(r.results.back().inertia->errors().delay_s, delay_s, 0.001);
    EXPECT_TRUE(r.results.back().diagnostics.imu_used);
    EXPECT_LT(rms_rotation_error_rad(r, 20), 0.0015) << delay_s;
  }
}

// The points take precedence: an IMU mounted otherwise than configured costs little accuracy.
TEST(OdometryWithImu, AWronglyMountedSensorIsNotBelieved) {
  TestImu imu = mems();
  imu.T_base_imu = pose_from_xyz_rpy_deg({0.0, 0.0, 0.0}, {180.0, 0.0, 90.0});
  const Ride wrong = ride({}, swings_after_a_second, imu, 50, Pose::Identity());
  EXPECT_LT(wrong.end_error_m, 0.03);
  // The worst step comes before the contradiction is detected.
  EXPECT_LT(wrong.worst_step_m, 0.1);
  EXPECT_FALSE(wrong.results.back().diagnostics.imu_used);
  EXPECT_GT(wrong.results.back().diagnostics.imu_contradictions, 1U);
  const Ride right = ride({}, swings_after_a_second, imu, 50);
  EXPECT_TRUE(right.results.back().diagnostics.imu_used);
  EXPECT_EQ(right.results.back().diagnostics.imu_contradictions, 0U);
}

// A blow: in one sweep the gyroscope shows a turn that did not take place, too far for any match.
TEST(OdometryWithImu, OneSweepOfWrongReadingsIsMatchedWithoutThem) {
  constexpr int kBlow = 25;
  const TestSensor sensor{.noise_m = 0.02};
  Odometry odometry({}, Pose::Identity());
  for (int k = 0; k < 40; ++k) {
    SweepData data = sweep_data({}, sensor, swings_after_a_second, mems(), k);
    for (ImuReading& reading : data.readings) {
      const std::int64_t since_ns =
          reading.stamp_ns - kStart_ns - kBlow * std::int64_t{100'000'000};
      if (since_ns > 0 && since_ns < 100'000'000) reading.rate_radps.z() += 6.0;
    }
    const OdometryResult result = odometry.process(data.features(k, sensor));
    EXPECT_TRUE(result.health == Health::kOk || result.health == Health::kDegenerate) << k;
    const Pose truth = swings_after_a_second(0.1).inverse() * swings_after_a_second(0.1 * (k + 1));
    EXPECT_LT((truth.inverse() * result.T_odom_base).translation().norm(), 0.1) << k;
    if (k == kBlow) {
      EXPECT_EQ(result.diagnostics.imu_contradictions, 1U);
    }
  }
}

TEST(OdometryWithImu, ReadingsThatStopAndComeBackAreUsedAgain) {
  const TestSensor sensor{.noise_m = 0.02};
  Odometry odometry({}, Pose::Identity());
  OdometryResult last;
  for (int k = 0; k < 40; ++k) {
    SweepData data = sweep_data({}, sensor, swings_after_a_second, mems(), k);
    if (k >= 20 && k < 25) data.readings.clear();
    last = odometry.process(data.features(k, sensor));
    if (k == 22) {
      EXPECT_FALSE(last.diagnostics.imu_used);
    }
  }
  EXPECT_TRUE(last.diagnostics.imu_used);
  const Pose truth = swings_after_a_second(0.1).inverse() * swings_after_a_second(4.0);
  EXPECT_LT((truth.inverse() * last.T_odom_base).translation().norm(), 0.02);
}

// A USB adapter stamps what it received together; a slow sensor has two readings for a sweep.
TEST(OdometryWithImu, ReadingsThatDoNotCoverTheSweepsAreReported) {
  const TestSensor sensor{.noise_m = 0.02};
  const auto covers = [&](double rate_hz, std::int64_t burst_ns) {
    TestImu imu = mems();
    imu.rate_hz = rate_hz;
    Odometry odometry({}, Pose::Identity());
    OdometryResult last;
    for (int k = 0; k < 3; ++k) {
      SweepData data = sweep_data({}, sensor, swings_after_a_second, imu, k);
      for (ImuReading& r : data.readings) {
        const std::int64_t into_ns = (r.stamp_ns - kStart_ns) % burst_ns;
        r.stamp_ns += into_ns / 50 - into_ns;
      }
      last = odometry.process(data.features(k, sensor));
    }
    return last.diagnostics.imu_covers;
  };
  EXPECT_TRUE(covers(200.0, 1));
  EXPECT_FALSE(covers(200.0, 40'000'000));
  EXPECT_FALSE(covers(10.0, 1));
}

// Sweeps without points: the IMU gives the motion.
TEST(OdometryWithImu, BridgesEmptySweeps) {
  const auto end_error_m = [](bool with_imu) {
    const TestSensor sensor{.noise_m = 0.02};
    Odometry odometry({}, Pose::Identity());
    double worst_m = 0.0;
    for (int k = 0; k < 30; ++k) {
      SweepData data = sweep_data({}, sensor, swings_after_a_second, mems(), k);
      if (!with_imu) data.readings.clear();
      if (k >= 20 && k < 25) data.points.clear();
      const OdometryResult r = odometry.process(data.features(k, sensor));
      const Pose truth =
          swings_after_a_second(0.1).inverse() * swings_after_a_second(0.1 * (k + 1));
      worst_m = std::max(worst_m, (truth.inverse() * r.T_odom_base).translation().norm());
    }
    return worst_m;
  };
  // Half a second of dead reckoning: only the noise of velocity and readings counts.
  EXPECT_LT(end_error_m(true), 0.05);
  EXPECT_GT(end_error_m(false), 0.2);
}

TEST(OdometryWithImu, ARestoredOneContinuesToTheByte) {
  const TestSensor sensor{.noise_m = 0.02};
  OdometryConfig config;
  config.window_sweeps = 5;
  Odometry odometry(config, Pose::Identity());
  std::vector<OdometryResult> results;
  for (int k = 0; k < 24; ++k) {
    const SweepData data = sweep_data({}, sensor, swings_after_a_second, mems(), k);
    results.push_back(odometry.process(data.features(k, sensor)));
  }
  Odometry restored(config, Pose::Identity());
  std::vector<CommittedSweep> commits;
  for (std::size_t k = 18 - restored.restore_depth(); k < 18; ++k) {
    commits.push_back(committed(results[k], sensor.period_ns));
  }
  restored.restore(commits);
  for (int k = 18; k < 24; ++k) {
    const SweepData data = sweep_data({}, sensor, swings_after_a_second, mems(), k);
    const OdometryResult again = restored.process(data.features(k, sensor));
    const OdometryResult& first = results[static_cast<std::size_t>(k)];
    EXPECT_EQ(std::memcmp(again.T_odom_base.matrix().data(), first.T_odom_base.matrix().data(),
                          16 * sizeof(double)),
              0)
        << k;
    ASSERT_TRUE(again.inertia && first.inertia);
    EXPECT_EQ(packed(*again.inertia), packed(*first.inertia)) << k;
  }
}

TEST(InertialAid, WhatItKnowsOfTheSensorDriftsWhileItPauses) {
  const OdometryConfig config;
  InertialAid aid(Pose::Identity());
  aid.take(InertialState{});
  for (int k = 0; k < 100; ++k) {
    aid.feel({}, kStart_ns + k * std::int64_t{100'000'000}, 100'000'000);
    aid.take(aid.learned(MotionState{}, Matrix12::Identity(), std::nullopt, config));
  }
  const auto state = aid.learned(MotionState{}, Matrix12::Identity(), std::nullopt, config);
  ASSERT_TRUE(state);
  const double seconds = 10.1;
  EXPECT_NEAR(state->covariance(0, 0), seconds * std::pow(config.imu_gravity_walk, 2), 1e-9);
  EXPECT_NEAR(state->covariance(6, 6), seconds * std::pow(config.imu_rate_walk, 2), 1e-12);
}

TEST(InertialState, ComesBackFromItsNumbers) {
  InertialState state;
  state.mean.setLinSpaced(1.0, 10.0);
  state.covariance.setRandom();
  state.cross.setRandom();
  state.mean_to_end_mps << 1.0, 2.0, 3.0;
  state.mean_force_from_end_mps2 << 7.0, 8.0, 9.0;
  state.rest_force_mps2 << 4.0, 5.0, 6.0;
  state.adjoins = state.resting = true;
  state.usual_fit = 0.25;
  state.contradictions = 3;
  state.on_probation = 40;
  state.right = 299;
  const std::vector<double> numbers = packed(state);
  const auto back = unpacked(numbers);
  ASSERT_TRUE(back);
  EXPECT_EQ(back->mean, state.mean);
  EXPECT_EQ(back->covariance, state.covariance);
  EXPECT_EQ(back->cross, state.cross);
  EXPECT_EQ(back->rest_force_mps2, state.rest_force_mps2);
  EXPECT_EQ(back->mean_to_end_mps, state.mean_to_end_mps);
  EXPECT_EQ(back->mean_force_from_end_mps2, state.mean_force_from_end_mps2);
  EXPECT_TRUE(back->adjoins && back->resting);
  EXPECT_EQ(back->usual_fit, state.usual_fit);
  EXPECT_EQ(back->contradictions, 3U);
  EXPECT_EQ(back->on_probation, 40U);
  EXPECT_EQ(back->right, 299U);
  EXPECT_FALSE(unpacked(std::span(numbers).first(244)));
  EXPECT_EQ(numbers.size(), 245U) << "the schema names the number";
}

}  // namespace
}  // namespace zloam::odometry
