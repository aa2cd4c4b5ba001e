#pragma once
// Running sums of points in a voxel, and the plane fitted to them.

#include <Eigen/Core>
#include <array>

#include "common/plane_map/config.hpp"

namespace zloam::plane_map {

/// Number, sum and sum of outer products of points relative to a fixed origin (the voxel's centre,
/// so that no digits are lost far from the map's origin).
template <typename Scalar>
struct MomentSums {
  std::array<Scalar, 3> sum{};
  std::array<Scalar, 6> squares{};  // xx xy xz yy yz zz

  void add(float x, float y, float z) {
    const auto dx = static_cast<Scalar>(x);
    const auto dy = static_cast<Scalar>(y);
    const auto dz = static_cast<Scalar>(z);
    sum[0] += dx;
    sum[1] += dy;
    sum[2] += dz;
    squares[0] += dx * dx;
    squares[1] += dx * dy;
    squares[2] += dx * dz;
    squares[3] += dy * dy;
    squares[4] += dy * dz;
    squares[5] += dz * dz;
  }

  /// Sums relative to the same origin.
  template <typename Other>
  void add(const MomentSums<Other>& other) {
    for (std::size_t i = 0; i < 3; ++i) sum[i] += static_cast<Scalar>(other.sum[i]);
    for (std::size_t i = 0; i < 6; ++i) squares[i] += static_cast<Scalar>(other.squares[i]);
  }

  /// Sums of `count` points relative to an origin that lies at `offset` from this one's.
  void add(const MomentSums& other, unsigned count, const std::array<float, 3>& offset) {
    const Scalar n(count);
    const std::array<Scalar, 3> d = {offset[0], offset[1], offset[2]};
    std::size_t at = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = i; j < 3; ++j, ++at) {
        squares[at] += other.squares[at] + other.sum[i] * d[j] + d[i] * (other.sum[j] + n * d[j]);
      }
    }
    for (std::size_t i = 0; i < 3; ++i) sum[i] += other.sum[i] + n * d[i];
  }
};

/// The same in double with its count, for fitting.
struct Moments {
  double count = 0.0;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  Eigen::Matrix3d squares = Eigen::Matrix3d::Zero();

  Moments() = default;
  template <typename Scalar>
  Moments(unsigned n, const MomentSums<Scalar>& s) : count(n) {
    sum << s.sum[0], s.sum[1], s.sum[2];
    squares << s.squares[0], s.squares[1], s.squares[2], s.squares[1], s.squares[3], s.squares[4],
        s.squares[2], s.squares[4], s.squares[5];
  }

  /// Adds moments whose origin lies at `offset` from this one's.
  void add(const Moments& other, const Eigen::Vector3d& offset);
  Eigen::Vector3d mean() const { return sum / count; }
  Eigen::Matrix3d covariance() const;
};

/// Limits of the gates in variances, from the configuration.
struct PlaneGates {
  double min_points;
  double max_thickness2;
  double min_width2;
  double aspect;
  double normal_error2;
};
PlaneGates own_gates(const PlaneMapConfig& config);
PlaneGates merged_gates(const PlaneMapConfig& config);

/// Eigenvectors and eigenvalues of the covariance, ascending; centre relative to the origin.
struct PrincipalAxes {
  Eigen::Vector3d centre;
  Eigen::Vector3d variances;
  Eigen::Matrix3d axes;  // columns

  /// Variance of the normal (rad^2) of a plane through n points.
  double normal_variance(double n) const { return variances[0] / (n * variances[1]); }
};
PrincipalAxes principal_axes(const Moments& moments);

bool is_plane(const PrincipalAxes& axes, double count, const PlaneGates& gates);

}  // namespace zloam::plane_map
