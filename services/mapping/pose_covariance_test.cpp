#include "mapping/pose_covariance.hpp"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>

namespace zloam::mapping {
namespace {

MappingConfig as_solved() {
  MappingConfig config;
  config.covariance_scale_m = config.covariance_scale_rad = 1.0;
  config.covariance_normal_error_rad = config.covariance_map_m = 0.0;
  config.covariance_turn_share = config.covariance_map_turn_rad = 0.0;
  return config;
}

// A covariance with rotated principal axes and correlated position and rotation.
Matrix6 solved() {
  Matrix6 root = Matrix6::Identity();
  root.diagonal() << 0.001, 0.002, 0.02, 0.0003, 0.0004, 0.0005;
  root(3, 1) = 0.0001;
  root(5, 0) = -0.0002;
  const Eigen::Matrix3d turned =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  Matrix6 axes = Matrix6::Zero();
  axes.topLeftCorner<3, 3>() = axes.bottomRightCorner<3, 3>() = turned;
  return axes * root * root.transpose() * axes.transpose();
}

TEST(PublishedCovariance, IsTheSolversWhereNothingIsAdded) {
  EXPECT_LT((published_covariance(solved(), 0.0, as_solved()) - solved()).norm(), 1e-18);
}

TEST(PublishedCovariance, TheMapsOwnErrorComesOnTopInEachDirection) {
  MappingConfig config = as_solved();
  config.covariance_map_m = 0.003;
  const Matrix6 more = published_covariance(solved(), 0.0, config) - solved();
  Vector6 expected = Vector6::Zero();
  expected.head<3>().setConstant(9e-6);
  EXPECT_LT((more - Matrix6(expected.asDiagonal())).norm(), 1e-16);
}

TEST(PublishedCovariance, AWeakDirectionIsLessSureThanSaidTheMoreTheWeakerItIs) {
  MappingConfig config = as_solved();
  config.covariance_normal_error_rad = 0.1;
  Matrix6 apart = Matrix6::Identity();
  apart.diagonal().head<3>() << 1e-6, 4e-6, 1e-4;
  const Eigen::Vector3d found = published_covariance(apart, 0.0, config).diagonal().head<3>();
  // v (1 + 0.01 v / 1e-6)
  EXPECT_NEAR(found[0], 1.01e-6, 1e-18);
  EXPECT_NEAR(found[1], 4.16e-6, 1e-18);
  EXPECT_NEAR(found[2], 2e-4, 1e-16);
}

TEST(PublishedCovariance, AChangeOfTheTurnMakesTheRotationUnsure) {
  MappingConfig config = as_solved();
  config.covariance_turn_share = 0.1;
  const Matrix6 more = published_covariance(solved(), 0.02, config) - solved();
  Vector6 expected = Vector6::Zero();
  expected.tail<3>().setConstant(4e-6);
  EXPECT_LT((more - Matrix6(expected.asDiagonal())).norm(), 1e-16);
}

TEST(PublishedCovariance, WhereTheTurnIsKnownBadlyTheMapIsTurnedToo) {
  MappingConfig config = as_solved();
  config.covariance_map_turn_rad = 0.001;
  Matrix6 apart = 1e-6 * Matrix6::Identity();
  apart.diagonal().tail<3>() << 1e-6, 2e-6, 6e-6;
  const Vector6 found = published_covariance(apart, 0.0, config).diagonal();
  // v (1 + 3e-6 / 1e-6), where 3e-6 is the mean of the three variances
  EXPECT_LT((found.tail<3>() - Eigen::Vector3d(4e-6, 8e-6, 24e-6)).norm(), 1e-18);
  EXPECT_EQ(found.head<3>(), Eigen::Vector3d(1e-6, 1e-6, 1e-6));
  apart.diagonal().tail<3>().setConstant(1.0);
  EXPECT_NEAR(published_covariance(apart, 0.0, config)(5, 5), 11.0, 1e-9);
}

TEST(PublishedCovariance, StaysSymmetricPositiveAndNoLessThanTheScaled) {
  MappingConfig scaled = as_solved();
  scaled.covariance_scale_m = MappingConfig{}.covariance_scale_m;
  scaled.covariance_scale_rad = MappingConfig{}.covariance_scale_rad;
  const Matrix6 found = published_covariance(solved(), 0.0, MappingConfig{});
  EXPECT_EQ(found, found.transpose());
  const Matrix6 more = found - published_covariance(solved(), 0.0, scaled);
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix6>(found).eigenvalues()[0], 0.0);
  EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix6>(more).eigenvalues()[0], -1e-15);
  EXPECT_TRUE(published_covariance(Matrix6::Zero(), 0.0, MappingConfig{}).allFinite());
}

}  // namespace
}  // namespace zloam::mapping
