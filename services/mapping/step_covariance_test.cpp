#include "mapping/step_covariance.hpp"

#include <gtest/gtest.h>

namespace zloam::mapping {
namespace {

const Matrix6 kStep = 1e-4 * Matrix6::Identity();

Pose along(double x) { return pose_from_xyz_rpy_deg({x, 0.0, 0.0}, {0.0, 0.0, 0.0}); }

struct Row {
  std::uint64_t sweep, prev_sweep;
  /// of the motion since sweep 10
  double steps;
};

TEST(StepCovariance, CountsThePosesThatMappingDidNotTake) {
  for (const Row& row : {Row{11, 10, 1.0}, {14, 13, 4.0}, {14, 10, 1.0}, {14, 12, 4.0}}) {
    StepCovariance covariance;
    covariance.add(10, 9, along(5.0), kStep);
    EXPECT_EQ(covariance.take(), kStep);
    covariance.add(row.sweep, row.prev_sweep, along(0.5 * static_cast<double>(row.sweep)), kStep);
    const Matrix6 since = covariance.take();
    EXPECT_DOUBLE_EQ(since(0, 0), row.steps * 1e-4) << row.sweep << " after " << row.prev_sweep;
    EXPECT_EQ(covariance.take(), Matrix6::Zero());
  }
}

// The rotation's error of the first step acts over the way of the second one.
TEST(StepCovariance, StepsAreAddedAtTheLastPose) {
  StepCovariance covariance;
  covariance.add(0, 0, along(0.0), kStep);
  covariance.add(1, 0, along(2.0), kStep);
  const Matrix6 since = covariance.take();
  EXPECT_DOUBLE_EQ(since(0, 0), 2e-4);
  EXPECT_DOUBLE_EQ(since(1, 1), 2e-4 + 4e-4);
}

}  // namespace
}  // namespace zloam::mapping
