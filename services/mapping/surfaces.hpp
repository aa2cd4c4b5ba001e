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
  /// variance of the axis' direction, rad^2 (plane only)
  double axis_variance = 0.0;
};

/// Line when the largest eigenvalue is more than `ratio` times the middle one.
std::optional<Surface> fit_line(std::span<const Neighbour> points, double ratio);

/// Plane when all points lie within distance_m of it and the middle eigenvalue is more than
/// spread_ratio times the smallest (points in a row make no plane).
std::optional<Surface> fit_plane(std::span<const Neighbour> points, double distance_m,
                                 double spread_ratio, double noise_m);

}  // namespace zloam::mapping
