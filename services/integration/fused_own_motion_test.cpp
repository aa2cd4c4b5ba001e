// Which poses the fused pose's covariance compares with the platform's own motion.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "integration/integration.hpp"
#include "integration/test_poses.hpp"

namespace zloam::integration {
namespace {

using test::along;
using test::correction;
using test::odometry;

constexpr double kSlow_m = 0.5, kFast_m = 1.0;
/// A third of the difference, which is the sigma of an unexplained step.
constexpr double kTold_m = 0.95 * (kFast_m - kSlow_m) / 3.0, kUntold_m = 0.05;

/// A replay along x with exact odometry and an exact map.
class Line {
 public:
  /// The pose after a step; sigma along the way.
  double step(double by_m) {
    x_m_ += by_m;
    at_ns_ += 100'000'000;
    OdometryPose pose = odometry(sweep_, true, epoch);
    pose.instant_ns = at_ns_;
    pose.T_odom_base = along(x_m_);
    pose.step_covariance *= 1e-4;
    pose.health = health;
    const std::vector<FusedPose> fused = integrator.add(pose);
    Correction mapped = correction(sweep_, Pose::Identity(), epoch);
    mapped.covariance *= 1e-4;
    mapped.health = of_map;
    integrator.add(mapped);
    ++sweep_;
    EXPECT_EQ(fused.size(), 1U) << sweep_;
    if (fused.empty()) return std::numeric_limits<double>::quiet_NaN();
    last = fused[0];
    return std::sqrt(last.covariance(0, 0));
  }
  void steps(int count, double by_m) {
    for (int i = 0; i < count; ++i) step(by_m);
  }
  void new_run() {
    integrator.new_run();
    sweep_ = 0;
  }
  /// Another instance continues.
  void restore() {
    OdometryPose pose = odometry(sweep_ - 1, true, epoch);
    pose.instant_ns = at_ns_;
    pose.T_odom_base = along(x_m_);
    integrator = Integrator{IntegrationConfig{}};
    integrator.restore(pose, along(x_m_));
    integrator.add(correction(sweep_ - 1, Pose::Identity(), epoch));
  }

  Integrator integrator{IntegrationConfig{}};
  FusedPose last;
  Health health = Health::kOk, of_map = Health::kOk;
  std::uint32_t epoch = 0;

 private:
  double x_m_ = 0.0;
  std::int64_t at_ns_ = 0;
  std::uint64_t sweep_ = 0;
};

struct Interruption {
  std::string name;
  std::function<void(Line&)> happens;
  bool forgets;
};

TEST(FusedOwnMotion, IsForgottenWhereThePosesDoNotFollowEachOther) {
  const std::vector<Interruption> all = {
      {"nothing", [](Line&) {}, false},
      {"new run", [](Line& line) { line.new_run(); }, true},
      {"restore", [](Line& line) { line.restore(); }, true},
      {"unmatched correction",
       [](Line& line) {
         line.of_map = Health::kPredicted;
         line.step(kSlow_m);
         line.of_map = Health::kOk;
         line.step(kSlow_m);
       },
       true},
      {"odometry without a match",
       [](Line& line) {
         line.health = Health::kPredicted;
         line.step(kSlow_m);
         line.health = Health::kOk;
       },
       true},
  };
  for (const Interruption& interruption : all) {
    Line line;
    line.steps(20, kSlow_m);
    interruption.happens(line);
    double worst_m = 0.0;
    for (int i = 0; i < 4; ++i) worst_m = std::max(worst_m, line.step(kFast_m));
    if (interruption.forgets) {
      EXPECT_LT(worst_m, kUntold_m) << interruption.name;
    } else {
      EXPECT_GT(worst_m, kTold_m) << interruption.name;
    }
  }
}

// Its first pose, guessed over the gap, is uncertain anyway; the first ones that are corrected are
// not compared with the motion before the gap.
TEST(FusedOwnMotion, IsForgottenInANewEpoch) {
  Line line;
  line.steps(20, kSlow_m);
  line.epoch = 1;
  line.step(kFast_m);
  EXPECT_EQ(line.last.health, Health::kBridging);
  for (int i = 0; i < 4; ++i) EXPECT_LT(line.step(kFast_m), kUntold_m) << i;
}

// An error of a pose that nothing measured is no example of an acceleration.
TEST(FusedOwnMotion, LearnsNothingFromAPoseWithoutAMatch) {
  Line line;
  line.steps(20, kSlow_m);
  line.health = Health::kPredicted;
  EXPECT_LT(line.step(kFast_m), kUntold_m);
  line.health = Health::kOk;
  line.steps(4, kSlow_m);
  EXPECT_GT(line.step(kFast_m), kTold_m);
}

TEST(FusedOwnMotion, ComparesTheFirstStepBehindAPartialRevolutionWithRest) {
  Line line;
  line.health = Health::kPredicted;
  line.step(kSlow_m);
  line.health = Health::kOk;
  EXPECT_LT(line.step(kSlow_m), kUntold_m);
  EXPECT_GT(line.step(kSlow_m), 0.95 * kSlow_m / 3.0);
  EXPECT_EQ(line.last.health, Health::kDegenerate);
  EXPECT_LT(line.step(kSlow_m), kUntold_m);
}

// The odometry has matched a sweep of which the source lost a part.
TEST(FusedOwnMotion, ComparesPosesOfALossySourceToo) {
  for (const Health of_source : {Health::kIncomplete, Health::kTooFewPoints}) {
    Line line;
    line.health = of_source;
    line.steps(20, kSlow_m);
    EXPECT_GT(line.step(kFast_m), kTold_m);
    EXPECT_EQ(line.last.health, of_source);
  }
}

}  // namespace
}  // namespace zloam::integration
