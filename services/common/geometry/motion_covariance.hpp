#pragma once
// Covariances and information of a pose and a twist together.

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "common/geometry/se3.hpp"

namespace zloam {

/// Covariance from one sigma for the translation and one for the rotation.
inline Matrix6 diagonal_covariance(double sigma_m, double sigma_rad) {
  Matrix6 out = Matrix6::Zero();
  out.diagonal().head<3>().setConstant(sigma_m * sigma_m);
  out.diagonal().tail<3>().setConstant(sigma_rad * sigma_rad);
  return out;
}

/// The covariance of (pose, twist) with the twist in another unit of time: its numbers multiplied
/// by `factor`.
inline Matrix12 with_twist_scaled(const Matrix12& covariance, double factor) {
  Vector12 units = Vector12::Ones();
  units.tail<6>().setConstant(factor);
  return units.asDiagonal() * covariance * units.asDiagonal();
}

/// The covariance of (pose, twist) after another measurement of the pose with covariance `bound`:
/// better known parts stay nearly unchanged, no part of the pose is less certain than `bound`.
/// Singular covariances are allowed, a bound must be positive.
inline Matrix12 with_bounded_pose(const Matrix12& covariance, const Matrix6& bound) {
  const Eigen::Matrix<double, 12, 6> of_pose = covariance.leftCols<6>();
  const Matrix6 sum = covariance.topLeftCorner<6, 6>() + bound;
  const Matrix12 bounded = covariance - of_pose * sum.ldlt().solve(of_pose.transpose());
  return 0.5 * (bounded + bounded.transpose());
}

/// Whether the sensor sees only a part of a revolution, by the times of the first and the last
/// point as fractions of the sweep. False if all points are of one instant.
inline bool sees_a_part(double first, double last) {
  constexpr double kRound = 0.9;
  return last > first && last - first < kRound;
}

/// When in a sweep its residuals saw the pose: the mean of their times, weighted by information, as
/// a fraction of the sweep after its middle. H: theirs, (pose in the middle, twist, ...).
template <int kSize>
double seen_at(const Eigen::Matrix<double, kSize, kSize>& H) {
  const double pose = H.template topLeftCorner<3, 3>().trace();
  const double cross = H.template block<3, 3>(0, 6).trace();
  return pose > 0.0 ? std::clamp(cross / pose, -0.5, 0.5) : 0.0;
}

/// with_bounded_pose() for a pose that is known best at another time of the sweep than its middle,
/// for which the covariance is given; `twist` is the motion over the sweep. A bound at the middle
/// would treat the twist as known too, as both errors are correlated; the end of the sweep would be
/// off by the twist's error, and the next sweep's twist by more, in the opposite direction.
inline Matrix12 with_bounded_pose_at(double seen_at, const Vector6& twist,
                                     const Matrix12& covariance, const Matrix6& bound) {
  Matrix12 there = Matrix12::Identity();
  there.topLeftCorner<6, 6>() = adjoint(exp_se3(-seen_at * twist));
  there.topRightCorner<6, 6>().diagonal().setConstant(seen_at);
  const Matrix12 back = there.inverse();
  return back * with_bounded_pose(there * covariance * there.transpose(), bound) * back.transpose();
}

/// with_bounded_pose() along one direction, a unit vector; a zero vector changes nothing.
inline Matrix12 with_bounded(const Matrix12& covariance, const Vector12& direction, double sigma) {
  const Vector12 along = covariance * direction;
  return covariance - along * along.transpose() / (direction.dot(along) + sigma * sigma);
}

/// Scales the information of normal equations H x = -g in a pose and its derivatives along a
/// translation, a unit vector, by the factor `kept`.
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

/// `bounded` with the twist's covariance from before the pose was bounded: treating the pose as
/// more certain, relative to the map built from it, says nothing about the twist. The rest stays,
/// so the sum is positive as long as full - bounded is.
inline Matrix12 with_twist_of(const Matrix12& bounded, const Matrix12& full) {
  Matrix12 out = bounded;
  out.bottomRightCorner<6, 6>() = full.bottomRightCorner<6, 6>();
  return out;
}

}  // namespace zloam
