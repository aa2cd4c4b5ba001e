#pragma once
// What the graph knows of where two submaps lie to each other: along the surest way through it.

#include <optional>
#include <span>
#include <vector>

#include "common/geometry/se3.hpp"
#include "graph/pose_graph.hpp"

namespace zloam::graph {

/// Covariance of T_x_to, tangent at `to`, for every node x that factors connect with `to`; surest
/// in translation first (Dijkstra).
std::vector<std::optional<Matrix6>> uncertainties(std::size_t to, std::span<const Pose> poses,
                                                  std::span<const Between> factors);

}  // namespace zloam::graph
