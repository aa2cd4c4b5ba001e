// An odometry that continues from the published results of another instance.

#include <gtest/gtest.h>

#include <span>
#include <vector>

#include "odometry/published_health.hpp"
#include "odometry/test_room.hpp"

namespace zloam::odometry {
namespace {

constexpr int kLast = 8;

TestWorld elsewhere() {
  TestWorld world;
  world.room = {{-4, -3, -1.2}, {14, 2.5, 3.5}};
  world.boxes = {{{1, -2, -1.2}, {2, 0, 1.5}}, {{-3, 0.5, -1.2}, {-1, 2, 2}}};
  return world;
}

Vector6 riding() {
  Vector6 twist;
  twist << 1.0, 0.0, 0.0, 0.0, 0.0, 0.3;
  return twist;
}

OdometryResult feed(Odometry& odometry, const TestWorld& world, int k) {
  const PointVector points =
      sweep_of(world, {.noise_m = 0.01}, exp_se3(riding() * (0.1 * k)), riding(), unsigned(k));
  FeatureSweep sweep;
  sweep.sweep = std::uint64_t(k);
  sweep.stamp_ns = k * 100000000LL;
  sweep.less_flat = points;
  return odometry.process(sweep);
}

/// The result as another instance receives it, of a sweep whose source has this health.
CommittedSweep published(const OdometryResult& result, Health source) {
  CommittedSweep sweep = committed(result, 100000000);
  sweep.health = own_health(published_health(result.health, source));
  return sweep;
}

// The instance before was killed when its last sweep fitted nowhere: that sweep must not become a
// part of the target.
TEST(RestoredOdometry, ALostSweepStaysLost) {
  for (const Health source : {Health::kOk, Health::kIncomplete}) {
    Odometry before({}, Pose::Identity());
    std::vector<OdometryResult> results;
    for (int k = 0; k < kLast; ++k) results.push_back(feed(before, {}, k));
    results.push_back(feed(before, elsewhere(), kLast));
    ASSERT_EQ(results.back().health, Health::kLost);
    std::vector<CommittedSweep> commits;
    for (const OdometryResult& r : results) commits.push_back(published(r, source));
    EXPECT_EQ(commits.front().health, Health::kOk);
    Odometry after({}, Pose::Identity());
    after.restore(commits);
    for (int k = kLast + 1; k < kLast + 4; ++k) {
      const TestWorld world = k == kLast + 1 ? elsewhere() : TestWorld{};
      const OdometryResult one = feed(before, world, k);
      const OdometryResult other = feed(after, world, k);
      EXPECT_EQ(other.health, one.health) << k;
      EXPECT_EQ(one.T_odom_base.matrix(), other.T_odom_base.matrix()) << k;
      EXPECT_EQ(one.covariance, other.covariance) << k;
    }
  }
}

// The instance before began a new frame, after a reset or a gap: the points of the old one lie
// elsewhere in it.
TEST(RestoredOdometry, AnEarlierFrameIsNoPartOfTheTarget) {
  Odometry before({}, Pose::Identity());
  std::vector<OdometryResult> results;
  for (int k = 0; k < kLast; ++k) {
    if (k == 5) before.reset();
    results.push_back(feed(before, {}, k));
  }
  ASSERT_EQ(results[5].prev_sweep, 5U);
  std::vector<CommittedSweep> commits;
  for (const OdometryResult& r : results) commits.push_back(published(r, Health::kOk));
  Odometry after({}, Pose::Identity());
  after.restore(commits);
  for (int k = kLast; k < kLast + 3; ++k) {
    const OdometryResult one = feed(before, {}, k);
    const OdometryResult other = feed(after, {}, k);
    EXPECT_EQ(one.T_odom_base.matrix(), other.T_odom_base.matrix()) << k;
    EXPECT_EQ(one.covariance, other.covariance) << k;
  }
}

// The oldest commits that are kept may be of lost sweeps: no target begins with them.
TEST(RestoredOdometry, NoTargetBeginsWithALostSweep) {
  Odometry before({}, Pose::Identity());
  std::vector<OdometryResult> results;
  for (int k = 0; k < kLast; ++k) results.push_back(feed(before, {}, k));
  for (int k = kLast; k < kLast + 2; ++k) results.push_back(feed(before, elsewhere(), k));
  ASSERT_EQ(results.back().health, Health::kLost);
  for (int k = kLast + 2; k < kLast + 12; ++k) results.push_back(feed(before, {}, k));
  ASSERT_EQ(results[kLast + 2].health, Health::kOk);
  std::vector<CommittedSweep> commits;
  for (const OdometryResult& r : results) commits.push_back(published(r, Health::kOk));
  Odometry with_lost({}, Pose::Identity()), without({}, Pose::Identity());
  with_lost.restore(std::span(commits).subspan(kLast));
  without.restore(std::span(commits).subspan(kLast + 2));
  const OdometryResult one = feed(with_lost, {}, kLast + 12);
  const OdometryResult other = feed(without, {}, kLast + 12);
  EXPECT_EQ(one.T_odom_base.matrix(), other.T_odom_base.matrix());
  EXPECT_EQ(one.covariance, other.covariance);
}

}  // namespace
}  // namespace zloam::odometry
