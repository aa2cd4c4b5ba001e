#pragma once
// Lines and planes through a few map points, as LOAM judges them: by the eigenvalues of their
// scatter.

#include <optional>
#include <span>

#include "mapping/layer_map.hpp"

namespace zloam::mapping {

/// A line (axis: unit direction) or plane (axis: unit normal) through a point, frame map.
struct Surface {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitX();
  /// covariance of the normal, rad^2, in its plane (plane only)
  Eigen::Matrix3d normal_covariance = Eigen::Matrix3d::Zero();
};

/// Line when the largest eigenvalue is more than `ratio` times the middle one.
std::optional<Surface> fit_line(std::span<const Neighbour> points, double ratio);

struct PlaneLimits {
  /// all points lie within, m
  double distance_m = 0.2;
  /// the middle eigenvalue is more than so many times the smallest: points in a row make no plane
  double spread_ratio = 3.0;
  /// and more than the square of this, m: nor does one ring that noise has thickened along the beam
  double spread_m = 0.0;
  double noise_m = 0.0;
};

std::optional<Surface> fit_plane(std::span<const Neighbour> points, const PlaneLimits& limits);

}  // namespace zloam::mapping
