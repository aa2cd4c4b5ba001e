#include "mapping/surfaces.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace zloam::mapping {
namespace {

struct Scatter {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d values = Eigen::Vector3d::Zero();  // ascending, m^2
  Eigen::Matrix3d vectors = Eigen::Matrix3d::Identity();
};

Scatter scatter(std::span<const Neighbour> points) {
  Scatter s;
  for (const Neighbour& p : points) s.mean += p.point;
  s.mean /= static_cast<double>(points.size());
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  for (const Neighbour& p : points) {
    const Eigen::Vector3d d = p.point - s.mean;
    covariance += d * d.transpose();
  }
  covariance /= static_cast<double>(points.size());
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(covariance);
  s.values = solver.eigenvalues().cwiseMax(0.0);
  s.vectors = solver.eigenvectors();
  return s;
}

}  // namespace

std::optional<Surface> fit_line(std::span<const Neighbour> points, double ratio) {
  if (points.size() < 3) return std::nullopt;
  const Scatter s = scatter(points);
  const bool is_line = s.values[2] > 0.0 && s.values[2] > ratio * s.values[1];
  if (!is_line || !s.vectors.allFinite()) return std::nullopt;
  return Surface{s.mean, s.vectors.col(2), Eigen::Matrix3d::Zero()};
}

std::optional<Surface> fit_plane(std::span<const Neighbour> points, const PlaneLimits& limits) {
  if (points.size() < 3) return std::nullopt;
  const Scatter s = scatter(points);
  const bool spread = s.values[1] > 0.0 && s.values[1] > limits.spread_ratio * s.values[0] &&
                      s.values[1] > limits.spread_m * limits.spread_m;
  if (!spread || !s.vectors.allFinite()) return std::nullopt;
  const Eigen::Vector3d normal = s.vectors.col(0);
  for (const Neighbour& p : points) {
    if (std::abs(normal.dot(p.point - s.mean)) > limits.distance_m) return std::nullopt;
  }
  // The normal tilts about each axis of the plane by the thickness over the spread along the other.
  const double thickness =
      std::max(s.values[0], limits.noise_m * limits.noise_m) / static_cast<double>(points.size());
  Surface plane{s.mean, normal, Eigen::Matrix3d::Zero()};
  for (const int axis : {1, 2}) {
    const Eigen::Vector3d v = s.vectors.col(axis);
    plane.normal_covariance += thickness / s.values[axis] * v * v.transpose();
  }
  return plane;
}

}  // namespace zloam::mapping
