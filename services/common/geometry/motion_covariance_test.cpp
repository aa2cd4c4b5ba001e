#include "common/geometry/motion_covariance.hpp"

#include <gtest/gtest.h>

namespace zloam {
namespace {

constexpr double kPose = 1e-4, kTwist = 0.04;

/// Covariance of (pose in the middle, twist) where the pose is known well at the fraction s of the
/// sweep, and the twist is known badly.
Matrix12 known_at(double s) {
  Matrix12 to_middle = Matrix12::Identity();
  to_middle.topRightCorner<6, 6>().diagonal().setConstant(-s);
  Vector12 variances;
  variances << Vector6::Constant(kPose), Vector6::Constant(kTwist);
  return to_middle * variances.asDiagonal() * to_middle.transpose();
}

class SeenAt : public testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Fractions, SeenAt, testing::Values(-0.4, -0.2, 0.0, 0.3, 0.5));

TEST_P(SeenAt, IsToldByTheInformation) {
  EXPECT_NEAR(seen_at<12>(known_at(GetParam()).inverse()), GetParam(), 1e-9);
}

TEST(SeesAPart, NotWhereTheViewGoesRoundOrAllIsOfOneInstant) {
  EXPECT_TRUE(sees_a_part(-0.5, -0.1));
  EXPECT_TRUE(sees_a_part(-0.2, 0.2));
  EXPECT_FALSE(sees_a_part(-0.5, 0.48));
  EXPECT_FALSE(sees_a_part(0.5, 0.5));
}

// A better known pose at that time does not constrain the twist; at the sweep's end the twist's
// uncertainty remains.
TEST_P(SeenAt, ABoundThereLeavesTheTwistAsOpenAsItWas) {
  const double s = GetParam();
  const Matrix6 bound = 1e-8 * Matrix6::Identity();
  const Matrix12 bounded = with_bounded_pose_at(s, Vector6::Zero(), known_at(s), bound);
  EXPECT_NEAR(bounded(6, 6), kTwist, 1e-12);
  Matrix12 to_end = Matrix12::Identity();
  to_end.topRightCorner<6, 6>().diagonal().setConstant(0.5);
  const Matrix12 end = to_end * bounded * to_end.transpose();
  EXPECT_NEAR(end(0, 0), (0.5 - s) * (0.5 - s) * kTwist, 2e-8);
}

TEST(WithBoundedPose, InTheMiddleItWouldClaimToKnowTheTwist) {
  const Matrix6 bound = 1e-8 * Matrix6::Identity();
  EXPECT_LT(with_bounded_pose(known_at(-0.4), bound)(6, 6), 0.1 * kTwist);
}

}  // namespace
}  // namespace zloam
