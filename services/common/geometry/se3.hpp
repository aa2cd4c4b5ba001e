#pragma once
// Rigid motions. A twist is (translation rho, rotation theta), in this order everywhere: tangent
// vectors, covariances (6x6, rows and columns x y z rx ry rz) and messages. Exp and Log of SE(3):
// Barfoot, State Estimation for Robotics (2017), section 7.1.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <vector>

namespace zloam {

using Pose = Eigen::Isometry3d;
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Vector12 = Eigen::Matrix<double, 12, 1>;
using Matrix12 = Eigen::Matrix<double, 12, 12>;

/// The matrix with hat(a) * b = a x b.
Eigen::Matrix3d hat(const Eigen::Vector3d& a);

/// Rotation by the rotation vector theta (rad).
Eigen::Matrix3d exp_so3(const Eigen::Vector3d& theta);

/// Rotation vector (rad, norm <= pi) of a rotation matrix.
Eigen::Vector3d log_so3(const Eigen::Matrix3d& rotation);

/// Motion reached after unit time under the constant body twist (rho, theta).
Pose exp_se3(const Vector6& twist);

/// exp_se3((first + i * step) * twist) for i in [0, count): along one screw. Each is a product of
/// two out of a few exponentials: equal up to rounding, at a quarter of the cost.
std::vector<Pose> exp_se3_along(const Vector6& twist, double first, double step, std::size_t count);

/// The twist whose exp_se3 is the motion; rotation below pi.
Vector6 log_se3(const Pose& motion);

/// Ad(T): exp_se3(adjoint(T) * x) = T * exp_se3(x) * T^-1.
Matrix6 adjoint(const Pose& pose);

/// Transforms a covariance with its tangent at `from` to the tangent at `to`.
Matrix6 carried(const Matrix6& covariance, const Pose& T_to_from);

/// The nearest rotation, to remove the drift of long products.
Pose normalised(const Pose& pose);

/// Pose from translation (m) and roll, pitch, yaw in degrees: R = Rz(yaw) * Ry(pitch) * Rx(roll).
Pose pose_from_xyz_rpy_deg(const Eigen::Vector3d& xyz_m, const Eigen::Vector3d& rpy_deg);

}  // namespace zloam
