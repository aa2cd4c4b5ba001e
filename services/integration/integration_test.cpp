#include "integration/integration.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "integration/test_poses.hpp"

namespace zloam::integration {
namespace {

using test::along;
using test::correction;
using test::odometry;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

struct Row {
  std::uint32_t every, delay;
  std::uint64_t sweep;
  std::optional<std::uint64_t> uses;
};

// docs/protocol.md, section 8: k = the greatest multiple of M that is <= n - D.
TEST(Integration, ScheduleOfCorrections) {
  const std::vector<Row> table = {
      {1, 1, 0, {}}, {1, 1, 1, 0}, {1, 1, 2, 1},  {1, 1, 99, 98}, {1, 0, 0, 0}, {1, 0, 7, 7},
      {1, 3, 2, {}}, {1, 3, 3, 0}, {1, 3, 10, 7}, {2, 1, 0, {}},  {2, 1, 1, 0}, {2, 1, 2, 0},
      {2, 1, 3, 2},  {2, 1, 4, 2}, {5, 1, 5, 0},  {5, 1, 6, 5},   {5, 2, 6, 0}, {5, 2, 7, 5},
      {3, 4, 3, {}}, {3, 4, 6, 0}, {3, 4, 7, 3},  {0, 1, 4, 3},
  };
  for (const Row& row : table) {
    IntegrationConfig config;
    config.mapping_every = row.every;
    config.correction_delay = row.delay;
    EXPECT_EQ(scheduled_correction(row.sweep, config), row.uses)
        << "M " << row.every << " D " << row.delay << " n " << row.sweep;
  }
}

TEST(Integration, ReplayWaitsForItsOwnCorrection) {
  Integrator integrator{IntegrationConfig{}};
  const auto first = integrator.add(odometry(0, true));
  ASSERT_THAT(first, SizeIs(1));
  EXPECT_FALSE(first[0].has_correction);
  EXPECT_TRUE(first[0].T_map_base.isApprox(along(0.0)));
  EXPECT_THAT(integrator.add(odometry(1, true)), IsEmpty());
  EXPECT_THAT(integrator.add(odometry(2, true)), IsEmpty());
  EXPECT_EQ(integrator.awaited(), 0U);
  // The correction of sweep 1 arrives first: pose 1 still waits for that of sweep 0, and pose 2
  // waits behind it.
  EXPECT_THAT(integrator.add(correction(1, along(0.02))), IsEmpty());
  EXPECT_EQ(integrator.waiting(), 2U);
  const auto both = integrator.add(correction(0, along(0.01)));
  ASSERT_THAT(both, SizeIs(2));
  EXPECT_EQ(both[0].correction_sweep, 0U);
  EXPECT_NEAR(both[0].T_map_base.translation().x(), 0.51, 1e-12);
  EXPECT_EQ(both[1].correction_sweep, 1U);
  EXPECT_NEAR(both[1].T_map_base.translation().x(), 1.02, 1e-12);
  EXPECT_EQ(both[1].instant_ns, 300'000'000);
}

// However corrections and poses interleave, the poses are the same.
TEST(Integration, ReplayDoesNotDependOnArrival) {
  IntegrationConfig config;
  config.mapping_every = 2;
  const auto T_at = [](std::uint64_t k) { return along(0.01 * static_cast<double>(k), 0.1); };
  std::vector<std::vector<double>> runs;
  for (int order = 0; order < 3; ++order) {
    Integrator integrator{config};
    std::vector<double> x;
    const auto take = [&x](const std::vector<FusedPose>& poses) {
      for (const FusedPose& p : poses) {
        x.push_back(p.T_map_base.translation().x());
        x.push_back(p.covariance.trace());
        x.push_back(static_cast<double>(p.sweep));
      }
    };
    const auto poses = [&] {
      for (std::uint64_t n = 0; n < 12; ++n) take(integrator.add(odometry(n, true)));
    };
    const auto corrections = [&] {
      for (std::uint64_t k = 0; k < 12; k += 2) take(integrator.add(correction(k, T_at(k))));
    };
    if (order == 0) {
      poses();
      corrections();
    } else if (order == 1) {
      corrections();
      poses();
    } else {
      for (std::uint64_t n = 0; n < 12; ++n) {
        take(integrator.add(odometry(n, true)));
        if (n % 2 == 0) take(integrator.add(correction(n, T_at(n))));
      }
    }
    EXPECT_THAT(x, SizeIs(36));
    EXPECT_EQ(integrator.waiting(), 0U);
    runs.push_back(x);
  }
  EXPECT_EQ(runs[0], runs[1]);
  EXPECT_EQ(runs[0], runs[2]);
}

/// A drive with drifting odometry and correcting mapping, from which the integrator learns.
std::vector<FusedPose> drive(Integrator& integrator, bool replay, std::uint64_t from,
                             std::uint64_t until) {
  std::vector<FusedPose> poses;
  const auto take = [&poses](const std::vector<FusedPose>& more) {
    poses.insert(poses.end(), more.begin(), more.end());
  };
  for (std::uint64_t n = from; n < until; ++n) {
    const double x = static_cast<double>(n);
    OdometryPose pose = odometry(n, replay);
    pose.T_odom_base = pose_from_xyz_rpy_deg({0.5 * x, std::sin(x), 0.01 * x}, {0.1 * x, 0.0, x});
    pose.weak.degenerate = n % 7 == 3;
    take(integrator.add(pose));
    // Live, mapping is one sweep behind.
    if (!replay && n == 0) continue;
    const std::uint64_t k = replay ? n : n - 1;
    take(
        integrator.add(correction(k, along(0.003 * static_cast<double>(k) + 0.002 * std::cos(x)))));
  }
  return poses;
}

// An instance that resumes the state of another one continues bit-exactly.
TEST(Integration, WhoResumesAStateGoesOnToTheBit) {
  for (const bool replay : {true, false}) {
    Integrator whole{IntegrationConfig{}};
    const std::vector<FusedPose> expected = drive(whole, replay, 0, 80);
    for (std::uint64_t at = 1; at < 79; ++at) {
      Integrator before{IntegrationConfig{}};
      const std::size_t left = drive(before, replay, 0, at).size();
      Integrator after{IntegrationConfig{}};
      ASSERT_TRUE(after.resume(before.state()));
      EXPECT_EQ(after.last_sweep(), before.last_sweep());
      const std::vector<FusedPose> rest = drive(after, replay, at, 80);
      ASSERT_EQ(left + rest.size(), expected.size());
      for (std::size_t i = 0; i < rest.size(); ++i) {
        const FusedPose& wanted = expected[left + i];
        ASSERT_EQ(rest[i].sweep, wanted.sweep);
        ASSERT_EQ(rest[i].T_map_base.matrix(), wanted.T_map_base.matrix()) << at << " " << i;
        ASSERT_EQ(rest[i].covariance, wanted.covariance) << at << " " << i;
        ASSERT_EQ(rest[i].health, wanted.health);
        ASSERT_EQ(rest[i].jump, wanted.jump);
      }
    }
  }
}

// However far back the correction of the next pose lies.
TEST(Integration, AReplayResumesToTheBitWithRareCorrectionsToo) {
  IntegrationConfig config;
  config.mapping_every = 50;
  config.correction_delay = 3;
  Integrator whole{config};
  const std::vector<FusedPose> expected = drive(whole, true, 0, 120);
  ASSERT_THAT(expected, SizeIs(120));
  for (std::uint64_t at = 1; at < 119; ++at) {
    Integrator before{config};
    drive(before, true, 0, at);
    Integrator after{config};
    ASSERT_TRUE(after.resume(before.state()));
    // Mapping keeps its corrections; the earlier ones are asked for again.
    after.add(correction(0, along(0.002)));
    for (const FusedPose& pose : drive(after, true, at, 120)) {
      const FusedPose& wanted = expected.at(pose.sweep);
      ASSERT_EQ(pose.T_map_base.matrix(), wanted.T_map_base.matrix()) << at << " " << pose.sweep;
      ASSERT_EQ(pose.covariance, wanted.covariance) << at << " " << pose.sweep;
    }
  }
}

TEST(Integration, WhatIsNoStateIsNotResumed) {
  Integrator one{IntegrationConfig{}};
  drive(one, true, 0, 20);
  const std::vector<std::uint64_t> state = one.state();
  for (std::size_t cut = 0; cut < state.size(); ++cut) {
    Integrator other{IntegrationConfig{}};
    EXPECT_FALSE(other.resume(std::span(state).first(cut)));
    EXPECT_FALSE(other.last_sweep().has_value());
  }
  std::vector<std::uint64_t> longer = state;
  longer.push_back(0);
  EXPECT_FALSE(Integrator{IntegrationConfig{}}.resume(longer));
}

TEST(Integration, LiveTakesTheNewestAndNeverWaits) {
  Integrator integrator{IntegrationConfig{}};
  EXPECT_FALSE(integrator.add(odometry(0, false)).at(0).has_correction);
  EXPECT_FALSE(integrator.add(odometry(1, false)).at(0).has_correction);
  EXPECT_THAT(integrator.add(correction(1, along(0.03))), IsEmpty());
  EXPECT_THAT(integrator.add(correction(0, along(9.0))), IsEmpty());
  const auto pose = integrator.add(odometry(2, false)).at(0);
  EXPECT_EQ(pose.correction_sweep, 1U);
  EXPECT_NEAR(pose.T_map_base.translation().x(), 1.03, 1e-12);
  EXPECT_EQ(integrator.add(odometry(5, false)).at(0).correction_sweep, 1U) << "a gap stops nothing";
  EXPECT_THAT(integrator.add(odometry(5, false)), IsEmpty()) << "a second copy";
  EXPECT_THAT(integrator.add(odometry(4, false)), IsEmpty()) << "late";
}

TEST(Integration, PosesThatAreCaughtUpWithTakeTheCorrectionsOfTheirTime) {
  Integrator integrator{IntegrationConfig{}};
  for (const std::uint64_t sweep : {4U, 6U, 8U}) {
    integrator.add(correction(sweep, along(0.01 * static_cast<double>(sweep))));
  }
  const std::vector<std::uint64_t> used = {4, 4, 4, 6, 6, 8};
  for (std::uint64_t sweep = 3; sweep < 9; ++sweep) {
    const auto fused = integrator.add(odometry(sweep, false));
    ASSERT_THAT(fused, SizeIs(1));
    EXPECT_EQ(fused[0].correction_sweep, used[sweep - 3]) << sweep;
  }
}

TEST(Integration, MarksJumps) {
  struct Step {
    Pose T_map_odom;
    bool jump;
  };
  const std::vector<Step> steps = {{along(0.05), false},     {along(0.10), false},
                                   {along(0.30), true},      {along(0.30), false},
                                   {along(0.30, 3.0), true}, {along(0.30, 3.0), false}};
  Integrator integrator{IntegrationConfig{}};
  OdometryPose pose = odometry(0, false);
  integrator.add(pose);
  for (std::size_t i = 0; i < steps.size(); ++i) {
    integrator.add(correction(i, steps[i].T_map_odom));
    pose.sweep = i + 1;
    EXPECT_EQ(integrator.add(pose).at(0).jump, steps[i].jump) << i;
  }
}

TEST(Integration, BridgesANewEpoch) {
  Integrator integrator{IntegrationConfig{}};
  integrator.add(odometry(0, false));
  integrator.add(correction(0, along(1.0)));
  const auto before = integrator.add(odometry(1, false)).at(0);
  EXPECT_NEAR(before.T_map_base.translation().x(), 1.5, 1e-12);
  // The new frame starts at identity, one sweep (0.1 s at 5 m/s) later.
  OdometryPose restarted = odometry(2, false, 1);
  restarted.T_odom_base = Pose::Identity();
  const auto bridged = integrator.add(restarted).at(0);
  EXPECT_EQ(bridged.health, Health::kBridging);
  EXPECT_FALSE(bridged.has_correction);
  EXPECT_TRUE(bridged.jump);
  EXPECT_NEAR(bridged.T_map_base.translation().x(), 2.0, 1e-9);
  // Odometry continues in its new frame; corrections of the old epoch must not be used.
  integrator.add(correction(1, along(77.0), 0));
  restarted.sweep = 3;
  restarted.T_odom_base = along(0.5);
  const auto next = integrator.add(restarted).at(0);
  EXPECT_EQ(next.health, Health::kBridging);
  EXPECT_NEAR(next.T_map_base.translation().x(), 2.5, 1e-9);
  integrator.add(correction(3, along(2.05), 1));
  restarted.sweep = 4;
  restarted.T_odom_base = along(1.0);
  const auto corrected = integrator.add(restarted).at(0);
  EXPECT_EQ(corrected.health, Health::kOk);
  EXPECT_NEAR(corrected.T_map_base.translation().x(), 3.05, 1e-9);
}

// After a minute without odometry nobody knows how the platform moved on: 300 m ahead, or turned
// round and round, it is not.
TEST(Integration, ALongGapIsBridgedByTheMotionOfSecondsOnly) {
  struct Gap {
    std::int64_t length_ns;
    double moved_m;
  };
  for (const Gap& gap : {Gap{2'000'000'000, 10.0}, {60'000'000'000, 25.0}, {-3'000'000'000, 0.0}}) {
    Integrator integrator{IntegrationConfig{}};
    const OdometryPose before = odometry(0, false);
    integrator.add(before);
    OdometryPose restarted = odometry(1, false, 1);
    restarted.instant_ns = before.instant_ns + gap.length_ns;
    restarted.T_odom_base = Pose::Identity();
    const auto bridged = integrator.add(restarted).at(0);
    EXPECT_EQ(bridged.health, Health::kBridging);
    EXPECT_NEAR(bridged.T_map_base.translation().x(), gap.moved_m, 1e-9);
  }
}

TEST(Integration, CarriesHealth) {
  Integrator integrator{IntegrationConfig{}};
  OdometryPose pose = odometry(0, false);
  pose.health = Health::kPredicted;
  pose.weak.degenerate = true;
  const auto fused = integrator.add(pose).at(0);
  EXPECT_EQ(fused.health, Health::kPredicted);
  EXPECT_TRUE(fused.weak.degenerate);
  Correction lost = correction(0, Pose::Identity());
  lost.health = Health::kLost;
  integrator.add(lost);
  EXPECT_EQ(integrator.add(odometry(1, false)).at(0).health, Health::kLost);
}

// What the test drive's second pose says: it begins in motion, at 5 m/s, and the first step is
// compared with rest.
Health moving_start(std::uint64_t sweep) { return sweep == 1 ? Health::kDegenerate : Health::kOk; }

// Mapping goes on publishing corrections, but has matched nothing since sweep 9: more than a second
// later the pose is Predicted, however wide its covariance.
TEST(Integration, CorrectionsThatMatchedNothingAreNone) {
  constexpr std::uint64_t kMatched = 9, kSecond = 10;
  for (const bool replay : {false, true}) {
    Integrator integrator{IntegrationConfig{}};
    for (std::uint64_t n = 0; n < 50; ++n) {
      const auto fused = integrator.add(odometry(n, replay));
      ASSERT_THAT(fused, SizeIs(1)) << n;
      const bool old = n > kMatched + kSecond;
      EXPECT_EQ(fused[0].health, old ? Health::kPredicted : moving_start(n)) << replay << ' ' << n;
      Correction c = correction(n, Pose::Identity());
      if (n > kMatched) {
        c.health = Health::kPredicted;
        c.covariance += 5e-4 * static_cast<double>(n - kMatched) * Matrix6::Identity();
      }
      integrator.add(c);
    }
  }
}

// A drive along x with an odometry error of slip_m per sweep and exact mapping.
struct Drive {
  double slip_m = 0.0;
  double acceleration_m = 0.0;  // change of the step from sweep to sweep
  Eigen::Vector3d weak = Eigen::Vector3d::Zero();
  bool replay = true;

  double truth(std::uint64_t n) const {
    const auto t = static_cast<double>(n);
    return 0.5 * t + 0.5 * acceleration_m * t * t;
  }
  OdometryPose odometry_of(std::uint64_t n) const {
    OdometryPose pose = odometry(n, replay);
    pose.T_odom_base = along(truth(n) - slip_m * static_cast<double>(n));
    pose.weak.degenerate = !weak.isZero();
    pose.weak.translation = weak;
    pose.weak.sigma_measured = 0.3;
    return pose;
  }
  Correction correction_of(std::uint64_t n) const {
    return correction(n, along(slip_m * static_cast<double>(n)));
  }
  /// Position errors of the fused poses.
  std::vector<double> errors_m(std::uint64_t sweeps) const {
    Integrator integrator{IntegrationConfig{}};
    std::vector<double> out;
    for (std::uint64_t n = 0; n < sweeps; ++n) {
      for (const FusedPose& fused : integrator.add(odometry_of(n))) {
        out.push_back(std::abs(fused.T_map_base.translation().x() - truth(fused.sweep)));
      }
      integrator.add(correction_of(n));
    }
    return out;
  }
};

TEST(Integration, AlongAWeakDirectionTheMapsMotionLeadsAtOnce) {
  const Drive drive{.slip_m = 0.1, .weak = Eigen::Vector3d::UnitX()};
  const auto errors = drive.errors_m(8);
  ASSERT_THAT(errors, SizeIs(8));
  // The speed is known from the first two mapped poses on.
  for (std::size_t n = 2; n < errors.size(); ++n) EXPECT_LT(errors[n], 0.015) << n;
}

TEST(Integration, OdometryThatErrsWithoutSayingSoIsFoundOut) {
  const auto errors = Drive{.slip_m = 0.1}.errors_m(60);
  ASSERT_THAT(errors, SizeIs(60));
  EXPECT_GT(errors[2], 0.05);
  for (std::size_t n = 30; n < errors.size(); ++n) EXPECT_LT(errors[n], 0.01) << n;
}

TEST(Integration, OdometryThatSeesLeadsThroughAChangeOfSpeed) {
  // The map's last motion is wrong by 4 cm in each sweep.
  const auto errors = Drive{.acceleration_m = 0.04}.errors_m(40);
  ASSERT_THAT(errors, SizeIs(40));
  for (const double error : errors) EXPECT_LT(error, 1e-3);
}

TEST(Integration, AcrossAWeakDirectionTheOdometryLeads) {
  const Drive drive{.slip_m = 0.1, .weak = Eigen::Vector3d::UnitX()};
  Integrator integrator{IntegrationConfig{}};
  for (std::uint64_t n = 0; n < 20; ++n) {
    integrator.add(drive.odometry_of(n));
    integrator.add(drive.correction_of(n));
  }
  OdometryPose pose = drive.odometry_of(20);
  pose.T_odom_base.translation().y() = 0.07;
  const auto fused = integrator.add(pose).at(0);
  EXPECT_NEAR(fused.T_map_base.translation().x(), 10.0, 0.01);
  EXPECT_NEAR(fused.T_map_base.translation().y(), 0.07, 0.01);
}

TEST(Integration, MotionOfTheMapGrowsOld) {
  const Drive drive{.slip_m = 0.1, .weak = Eigen::Vector3d::UnitX(), .replay = false};
  Integrator integrator{IntegrationConfig{}};
  for (std::uint64_t n = 0; n < 3; ++n) {
    integrator.add(drive.odometry_of(n));
    integrator.add(drive.correction_of(n));
  }
  // No more corrections: after half a second only the odometry's steps count.
  double last = 0.0;
  for (std::uint64_t n = 3; n < 12; ++n) {
    const auto fused = integrator.add(drive.odometry_of(n)).at(0);
    const double x = fused.T_map_base.translation().x();
    if (n > 10) {
      EXPECT_NEAR(x - last, 0.4, 1e-9);
    }
    last = x;
  }
}

// Mapping has died: the odometry errs by 0.1 m a sweep, as it was seen to do before.
TEST(Integration, WithoutTheMapThePoseGrowsUncertain) {
  const Drive drive{.slip_m = 0.1, .replay = false};
  Integrator integrator{IntegrationConfig{}};
  FusedPose fused;
  for (std::uint64_t n = 0; n < 90; ++n) {
    fused = integrator.add(drive.odometry_of(n)).at(0);
    if (n < 40) integrator.add(drive.correction_of(n));
    if (n == 39) {
      EXPECT_LT(std::sqrt(fused.covariance(0, 0)), 0.04);
    }
  }
  EXPECT_GT(std::sqrt(fused.covariance(0, 0)), 0.4);
}

TEST(Integration, WeakDirectionOfTheMapIsSaidInThePosesOwnAxes) {
  Integrator integrator{IntegrationConfig{}};
  integrator.add(odometry(0, false));
  Correction c = correction(0, Pose::Identity());
  c.weak.degenerate = true;
  c.weak.translation = Eigen::Vector3d::UnitX();
  integrator.add(c);
  OdometryPose turned = odometry(1, false);
  turned.T_odom_base = along(0.5, 90.0);
  const auto fused = integrator.add(turned).at(0);
  EXPECT_TRUE(fused.weak.degenerate);
  EXPECT_EQ(fused.health, Health::kDegenerate);
  EXPECT_TRUE(fused.weak.translation.isApprox(-Eigen::Vector3d::UnitY(), 1e-12));
}

TEST(Integration, NotFiniteValuesDoNoHarm) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Integrator integrator{IntegrationConfig{}};
  OdometryPose pose = odometry(0, false);
  pose.step_covariance(2, 2) = nan;
  EXPECT_TRUE(integrator.add(pose).at(0).covariance.allFinite());
  Correction bad = correction(0, Pose::Identity());
  bad.T_map_odom.translation().x() = nan;
  integrator.add(bad);
  EXPECT_TRUE(integrator.add(odometry(1, false)).at(0).T_map_base.matrix().allFinite());
  for (std::uint64_t n = 2; n < 5; ++n) {
    OdometryPose weak = odometry(n, false);
    weak.weak.degenerate = true;
    weak.weak.translation.setConstant(nan);
    EXPECT_TRUE(integrator.add(weak).at(0).T_map_base.matrix().allFinite());
    integrator.add(correction(n, Pose::Identity()));
  }
}

TEST(Integration, ResetForgetsTheRun) {
  Integrator integrator{IntegrationConfig{}};
  integrator.add(odometry(4, false));
  integrator.add(correction(4, along(3.0)));
  integrator.reset();
  const auto pose = integrator.add(odometry(0, false)).at(0);
  EXPECT_FALSE(pose.has_correction);
  EXPECT_FALSE(pose.jump);
}

// A covariance so small that a second of odometry does not make the pose degenerate.
Correction sure(Correction correction) {
  correction.covariance *= 1e-3;
  return correction;
}

TEST(Integration, APoseSaysThatItsCorrectionIsOld) {
  for (const bool any_correction : {true, false}) {
    Integrator integrator{IntegrationConfig{}};
    std::string healths;
    const auto go = [&](std::uint64_t sweep) {
      for (const FusedPose& pose : integrator.add(odometry(sweep, false))) {
        healths += std::to_string(static_cast<int>(pose.health));
      }
    };
    go(0);
    if (any_correction) integrator.add(sure(correction(0, along(0))));
    for (std::uint64_t sweep = 1; sweep <= 13; ++sweep) go(sweep);
    // At sweep 10 the correction is 1 s old, the limit; later poses are Predicted.
    EXPECT_EQ(healths, "04000000000555");
    integrator.add(sure(correction(12, along(0))));
    go(14);
    EXPECT_EQ(healths.back(), '0');
  }
}

TEST(Integration, InReplayACorrectionIsNeverOld) {
  IntegrationConfig config;
  config.mapping_every = 30;
  Integrator integrator{config};
  integrator.add(sure(correction(0, along(0))));
  for (std::uint64_t sweep = 0; sweep < 30; ++sweep) {
    const auto fused = integrator.add(odometry(sweep, true));
    ASSERT_THAT(fused, SizeIs(1)) << sweep;
    EXPECT_EQ(fused[0].health, moving_start(sweep)) << sweep;
  }
}

}  // namespace
}  // namespace zloam::integration
