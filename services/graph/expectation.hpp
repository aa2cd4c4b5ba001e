#pragma once
// Expected relative pose of two submaps: along the path of least uncertainty through the graph.

#include <optional>
#include <span>
#include <vector>

#include "common/geometry/se3.hpp"
#include "graph/pose_graph.hpp"

namespace zloam::graph {

/// Covariance of T_x_to, tangent at `to`, for every node x connected with `to` by factors; along
/// the path of least translation uncertainty (Dijkstra).
std::vector<std::optional<Matrix6>> uncertainties(std::size_t to, std::span<const Pose> poses,
                                                  std::span<const Between> factors);

}  // namespace zloam::graph
