#include "common/geometry/se3.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace zloam {
namespace {

// Coefficients of the closed forms; series below 1e-4 rad, where the quotients lose digits.
struct Coefficients {
  double a;  // sin(t) / t
  double b;  // (1 - cos t) / t^2
  double c;  // (t - sin t) / t^3
};

Coefficients coefficients(double angle) {
  const double t2 = angle * angle;
  if (angle < 1e-4) {
    return {1.0 - t2 / 6.0, 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0};
  }
  return {std::sin(angle) / angle, (1.0 - std::cos(angle)) / t2,
          (angle - std::sin(angle)) / (t2 * angle)};
}

}  // namespace

Eigen::Matrix3d hat(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0.0, -a.z(), a.y(), a.z(), 0.0, -a.x(), -a.y(), a.x(), 0.0;
  return m;
}

Eigen::Matrix3d exp_so3(const Eigen::Vector3d& theta) {
  const Coefficients k = coefficients(theta.norm());
  const Eigen::Matrix3d w = hat(theta);
  return Eigen::Matrix3d::Identity() + k.a * w + k.b * w * w;
}

Eigen::Vector3d log_so3(const Eigen::Matrix3d& rotation) {
  Eigen::Quaterniond q(rotation);
  q.normalize();
  if (q.w() < 0.0) {
    q.coeffs() = -q.coeffs();
  }
  const double sin_half = q.vec().norm();
  if (sin_half < 1e-9) {
    return 2.0 * q.vec();
  }
  return q.vec() * (2.0 * std::atan2(sin_half, q.w()) / sin_half);
}

Pose exp_se3(const Vector6& twist) {
  const Eigen::Vector3d theta = twist.tail<3>();
  const Coefficients k = coefficients(theta.norm());
  const Eigen::Matrix3d w = hat(theta);
  const Eigen::Matrix3d w2 = w * w;
  Pose motion = Pose::Identity();
  motion.linear() = Eigen::Matrix3d::Identity() + k.a * w + k.b * w2;
  motion.translation() = (Eigen::Matrix3d::Identity() + k.b * w + k.c * w2) * twist.head<3>();
  return motion;
}

std::vector<Pose> exp_se3_along(const Vector6& twist, double first, double step,
                                std::size_t count) {
  constexpr std::size_t kApart = 32;
  std::array<Pose, kApart> from_anchor;
  for (std::size_t i = 0; i < std::min(kApart, count); ++i) {
    from_anchor[i] = exp_se3((static_cast<double>(i) * step) * twist);
  }
  std::vector<Pose> motions;
  motions.reserve(count);
  while (motions.size() < count) {
    const Pose anchor = exp_se3((first + static_cast<double>(motions.size()) * step) * twist);
    const std::size_t end = std::min(count, motions.size() + kApart);
    for (std::size_t i = 0; motions.size() < end; ++i) motions.push_back(anchor * from_anchor[i]);
  }
  return motions;
}

Vector6 log_se3(const Pose& motion) {
  const Eigen::Vector3d theta = log_so3(motion.linear());
  const double t = theta.norm();
  const Eigen::Matrix3d w = hat(theta);
  // Inverse of the left Jacobian: I - w/2 + d w^2, d -> 1/12 for small angles.
  const double d =
      t < 1e-4 ? 1.0 / 12.0 : (1.0 - t * std::cos(t / 2.0) / (2.0 * std::sin(t / 2.0))) / (t * t);
  Vector6 twist;
  twist.head<3>() = (Eigen::Matrix3d::Identity() - 0.5 * w + d * w * w) * motion.translation();
  twist.tail<3>() = theta;
  return twist;
}

Matrix6 adjoint(const Pose& pose) {
  const Eigen::Matrix3d r = pose.linear();
  Matrix6 ad = Matrix6::Zero();
  ad.topLeftCorner<3, 3>() = r;
  ad.rightCols<3>() << hat(pose.translation()) * r, r;
  return ad;
}

Matrix6 carried(const Matrix6& covariance, const Pose& T_to_from) {
  const Matrix6 Ad = adjoint(T_to_from);
  return Ad * covariance * Ad.transpose();
}

Pose normalised(const Pose& pose) {
  Pose out = Pose::Identity();
  out.linear() = Eigen::Quaterniond(pose.linear()).normalized().toRotationMatrix();
  out.translation() = pose.translation();
  return out;
}

Pose pose_from_xyz_rpy_deg(const Eigen::Vector3d& xyz_m, const Eigen::Vector3d& rpy_deg) {
  const Eigen::Vector3d rpy = rpy_deg * (std::numbers::pi / 180.0);
  Pose out = Pose::Identity();
  out.linear() = (Eigen::AngleAxisd(rpy.z(), Eigen::Vector3d::UnitZ()) *
                  Eigen::AngleAxisd(rpy.y(), Eigen::Vector3d::UnitY()) *
                  Eigen::AngleAxisd(rpy.x(), Eigen::Vector3d::UnitX()))
                     .toRotationMatrix();
  out.translation() = xyz_m;
  return out;
}

}  // namespace zloam
