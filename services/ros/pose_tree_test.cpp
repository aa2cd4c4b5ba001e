// Compares the covariance accumulated along a way, and T_map_odom, with those of random samples.

#include "ros/pose_tree.hpp"

#include <gtest/gtest.h>

#include <numbers>
#include <random>
#include <utility>
#include <vector>

namespace zloam::ros {
namespace {

Vector6 drawn(std::mt19937& random, const Vector6& sigma) {
  std::normal_distribution<double> normal;
  Vector6 v;
  for (int i = 0; i < 6; ++i) v[i] = sigma[i] * normal(random);
  return v;
}

const Vector6 kStep = (Vector6() << 1.0, 0.0, 0.0, 0.0, 0.0, 0.2).finished();
const Vector6 kSigma = (Vector6() << 0.01, 0.02, 0.005, 0.001, 0.002, 0.004).finished();
constexpr int kSteps = 12;

OdometryStep step_at(int n, const Pose& pose) {
  OdometryStep step;
  step.sweep = static_cast<std::uint64_t>(n);
  step.instant_ns = n * std::int64_t{100'000'000};
  step.T_odom_base = pose;
  if (n > 0) step.step_covariance = kSigma.cwiseAbs2().asDiagonal();
  return step;
}

TEST(PoseTree, TheCovarianceIsThatOfManyNoisyWays) {
  PoseTree tree;
  Pose pose = Pose::Identity();
  PoseTree::Uncertainty said = tree.add(step_at(0, pose));
  EXPECT_EQ(said.pose, Matrix6::Zero().eval());
  for (int n = 1; n <= kSteps; ++n) {
    pose = pose * exp_se3(kStep);
    said = tree.add(step_at(n, pose));
  }
  std::mt19937 random(3);
  Matrix6 seen = Matrix6::Zero();
  constexpr int kWays = 20'000;
  for (int way = 0; way < kWays; ++way) {
    Pose noisy = Pose::Identity();
    for (int n = 0; n < kSteps; ++n)
      noisy = noisy * exp_se3(kStep) * exp_se3(drawn(random, kSigma));
    Vector6 error;
    error << noisy.translation() - pose.translation(),
        log_so3(noisy.linear() * pose.linear().transpose());
    seen += error * error.transpose() / kWays;
  }
  for (int i = 0; i < 6; ++i) {
    EXPECT_NEAR(said.pose(i, i) / seen(i, i), 1.0, 0.05) << i;
  }
  EXPECT_NEAR(said.pose(1, 5), seen(1, 5), 0.1 * std::abs(seen(1, 5)));
  EXPECT_NEAR(said.twist(0, 0), 0.1 * 0.1, 1e-12);
}

TEST(PoseTree, ANewFrameBeginsExactly) {
  PoseTree tree;
  tree.add(step_at(0, Pose::Identity()));
  tree.add(step_at(1, exp_se3(kStep)));
  OdometryStep fresh = step_at(2, Pose::Identity());
  fresh.epoch = 1;
  EXPECT_EQ(tree.add(fresh).pose, Matrix6::Zero().eval());
}

// A lost message is requested again and comes after the next one; after a take-over the last sweep
// may come twice.
TEST(PoseTree, ASweepThatComesLateOrTwiceKeepsTheCovariance) {
  PoseTree in_order, as_it_comes;
  Pose pose = Pose::Identity();
  std::vector<OdometryStep> steps;
  for (int n = 0; n <= kSteps; ++n, pose = pose * exp_se3(kStep)) steps.push_back(step_at(n, pose));
  PoseTree::Uncertainty wanted, found;
  for (const OdometryStep& step : steps) wanted = in_order.add(step);
  std::swap(steps[5], steps[6]);
  steps.insert(steps.begin() + 9, steps[8]);
  for (const OdometryStep& step : steps) {
    found = as_it_comes.add(step);
    if (step.sweep > 0) {
      EXPECT_GT(found.pose.trace(), 0.0) << step.sweep;
    }
    if (step.sweep == 5) {
      EXPECT_NEAR(found.twist(0, 0), 0.1 * 0.1, 1e-12);
    }
  }
  EXPECT_TRUE(found.pose.isApprox(wanted.pose, 1e-12));
}

// The second replay has the same run and the same odom frame.
TEST(PoseTree, ARecordingThatIsReplayedAgainBeginsExactly) {
  for (const int last : {kSteps, 10 * kSteps}) {
    PoseTree tree;
    PoseTree::Uncertainty first, second;
    for (int n = 0; n <= last; ++n) first = tree.add(step_at(n, Pose::Identity()));
    EXPECT_EQ(tree.add(step_at(0, Pose::Identity())).pose, Matrix6::Zero().eval());
    for (int n = 1; n <= last; ++n) second = tree.add(step_at(n, Pose::Identity()));
    EXPECT_EQ(second.pose, first.pose) << last;
    tree.add(MapStep{0, static_cast<std::uint64_t>(last), 77, exp_se3(kStep)});
    EXPECT_EQ(tree.take_corrections().size(), 1U);
  }
}

TEST(PoseTree, AFrameThatContinuesInAnotherRunKeepsItsCovariance) {
  PoseTree one_run, two_runs;
  Pose pose = Pose::Identity();
  PoseTree::Uncertainty whole, parted;
  for (int n = 0; n <= kSteps; ++n, pose = pose * exp_se3(kStep)) {
    OdometryStep step = step_at(n, pose);
    whole = one_run.add(step);
    step.run = n < kSteps / 2 ? 1 : 2;
    parted = two_runs.add(step);
  }
  EXPECT_GT(whole.pose.trace(), 0.0);
  EXPECT_EQ(parted.pose, whole.pose);
}

TEST(PoseTree, TheMapIsWhereBothPosesOfASweepSaySo) {
  const Pose T_map_odom = exp_se3((Vector6() << 3.0, -1.0, 0.5, 0.1, 0.0, 0.7).finished());
  const Pose T_odom_base = exp_se3(kStep);
  for (const bool map_first : {false, true}) {
    PoseTree tree;
    const MapStep map{0, 5, 77, T_map_odom * T_odom_base};
    if (map_first) tree.add(map);
    tree.add(MapStep{0, 6, 78, Pose::Identity()});
    tree.add(MapStep{1, 5, 79, Pose::Identity()});
    tree.add(step_at(5, T_odom_base));
    if (!map_first) tree.add(map);
    const auto found = tree.take_corrections();
    ASSERT_EQ(found.size(), 1U);
    EXPECT_EQ(found[0].instant_ns, 77);
    EXPECT_TRUE(found[0].T_map_odom.isApprox(T_map_odom, 1e-12));
    EXPECT_TRUE(tree.take_corrections().empty());
  }
}

}  // namespace
}  // namespace zloam::ros
