#pragma once
// Covariances and information of a pose and a twist together.

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "common/geometry/se3.hpp"

namespace zloam {

/// Of a translation and a rotation, by one sigma each.
inline Matrix6 diagonal_covariance(double sigma_m, double sigma_rad) {
  Matrix6 out = Matrix6::Zero();
  out.diagonal().head<3>().setConstant(sigma_m * sigma_m);
  out.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
  return out;
}

/// The covariance of (pose, twist) with the twist in another unit of time, `factor` times the
/// number.
inline Matrix12 with_twist_scaled(const Matrix12& covariance, double factor) {
  Vector12 units = Vector12::Ones();
  units.tail<6>().setConstant(factor);
  return units.asDiagonal() * covariance * units.asDiagonal();
}

/// The covariance of (pose, twist) after the pose was also measured with another one, `bound`: what
/// is known better stays nearly as it is, nothing of the pose is less sure than that. Singular
/// covariances are allowed, a bound must be positive.
inline Matrix12 with_bounded_pose(const Matrix12& covariance, const Matrix6& bound) {
  const Eigen::Matrix<double, 12, 6> of_pose = covariance.leftCols<6>();
  const Matrix6 sum = covariance.topLeftCorner<6, 6>() + bound;
  const Matrix12 bounded = covariance - of_pose * sum.ldlt().solve(of_pose.transpose());
  return 0.5 * (bounded + bounded.transpose());
}

/// Whether the sensor's view is a part of its turn, by the times of the first and the last point as
/// fractions of the sweep. Not where all points are of one instant.
inline bool sees_a_part(double first, double last) {
  constexpr double kRound = 0.9;
  return last > first && last - first < kRound;
}

/// When in a sweep its residuals saw the pose: the mean of their times, weighted by information, as
/// a fraction of the sweep after its middle. H: theirs, of (pose in the middle, twist, ...).
template <int kSize>
double seen_at(const Eigen::Matrix<double, kSize, kSize>& H) {
  const double pose = H.template topLeftCorner<3, 3>().trace();
  const double cross = H.template block<3, 3>(0, 6).trace();
  return pose > 0.0 ? std::clamp(cross / pose, -0.5, 0.5) : 0.0;
}

/// with_bounded_pose() for a pose that is known best at another time of the sweep than its middle,
/// that of the covariance; `twist` is the motion over the sweep. A bound on the middle would take
/// the twist for known as well, as both err together; the end of the sweep were then off by what
/// the twist errs, and the next sweep's twist by more, the other way round.
inline Matrix12 with_bounded_pose_at(double seen_at, const Vector6& twist,
                                     const Matrix12& covariance, const Matrix6& bound) {
  Matrix12 there = Matrix12::Identity();
  there.topLeftCorner<6, 6>() = adjoint(exp_se3(-seen_at * twist));
  there.topRightCorner<6, 6>().diagonal().setConstant(seen_at);
  const Matrix12 back = there.inverse();
  return back * with_bounded_pose(there * covariance * there.transpose(), bound) * back.transpose();
}

/// with_bounded_pose() in one direction, a unit vector; a zero one changes nothing.
inline Matrix12 with_bounded(const Matrix12& covariance, const Vector12& direction, double sigma) {
  const Vector12 along = covariance * direction;
  return covariance - along * along.transpose() / (direction.dot(along) + sigma * sigma);
}

/// Of normal equations in a pose and its derivatives, H x = -g: of what they say along a
/// translation, a unit vector, the share `kept` stays.
template <int kSize>
void keep_along(const Eigen::Vector3d& direction, double kept,
                Eigen::Matrix<double, kSize, kSize>& H, Eigen::Matrix<double, kSize, 1>& g) {
  static_assert(kSize % 6 == 0);
  Eigen::Matrix<double, kSize, kSize> P = Eigen::Matrix<double, kSize, kSize>::Identity();
  for (int at = 0; at < kSize; at += 6) {
    P.template block<3, 3>(at, at) -= (1.0 - std::sqrt(kept)) * direction * direction.transpose();
  }
  H = (P * H * P).eval();
  g = (P * g).eval();
}

/// `bounded` with the covariance of the twist as it was before the pose was bounded: that the pose
/// is taken to be surer, relative to what was drawn from it, says nothing of the twist. The rest
/// stays, so the sum is positive as long as full - bounded is.
inline Matrix12 with_twist_of(const Matrix12& bounded, const Matrix12& full) {
  Matrix12 out = bounded;
  out.bottomRightCorner<6, 6>() = full.bottomRightCorner<6, 6>();
  return out;
}

}  // namespace zloam
