#pragma once
// Recent errors of one prediction of motion: mean squares in each direction, over about the last
// ten errors.

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

#include "common/geometry/se3.hpp"

namespace zloam {

/// The part of an error, separately for translation and rotation, that its own covariance does not
/// explain, in each principal direction of the covariance. Along unconstrained directions nothing
/// remains, as nothing was measured there.
inline Vector6 unexplained(const Vector6& error, const Matrix6& covariance) {
  Vector6 out;
  for (const int at : {0, 3}) {
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(Eigen::Matrix3d(covariance.block<3, 3>(at, at)));
    Eigen::Vector3d along = solver.eigenvectors().transpose() * error.segment<3>(at);
    for (int i = 0; i < 3; ++i) {
      const double beyond = along[i] * along[i] - solver.eigenvalues()[i];
      along[i] = std::copysign(std::sqrt(std::max(0.0, beyond)), along[i]);
    }
    out.segment<3>(at) = solver.eigenvectors() * along;
  }
  return out;
}

class ErrorRecord {
 public:
  /// Assumed before the first error, one sigma.
  ErrorRecord(double sigma_m, double sigma_rad)
      : translation_(sigma_m * sigma_m * Eigen::Matrix3d::Identity()),
        rotation_(sigma_rad * sigma_rad * Eigen::Matrix3d::Identity()) {}

  /// An error in the body's tangent. The first errors count as much as the assumption: a prediction
  /// that is off by decimetres from the start must not be trusted for as long as a record with a
  /// long memory takes to learn it.
  void add(const Vector6& error) {
    const Eigen::Vector3d t = error.head<3>();
    const Eigen::Vector3d r = error.tail<3>();
    ++errors_;
    const double stays = std::min(kMemory, errors_ / (errors_ + 1.0));
    translation_ = stays * translation_ + (1.0 - stays) * t * t.transpose();
    rotation_ = stays * rotation_ + (1.0 - stays) * r * r.transpose();
  }

  const Eigen::Matrix3d& translation() const { return translation_; }
  const Eigen::Matrix3d& rotation() const { return rotation_; }
  Matrix6 covariance() const {
    Matrix6 out = Matrix6::Zero();
    out.topLeftCorner<3, 3>() = translation_;
    out.bottomRightCorner<3, 3>() = rotation_;
    return out;
  }
  int errors() const { return errors_; }

  /// The whole state, to save or restore it.
  template <class Bits>
  void each(Bits& bits) {
    bits(translation_, rotation_, errors_);
  }

 private:
  static constexpr double kMemory = 0.9;
  Eigen::Matrix3d translation_;
  Eigen::Matrix3d rotation_;
  int errors_ = 0;
};

}  // namespace zloam
