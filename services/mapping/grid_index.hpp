#pragma once
// Which cube of a regular grid a point lies in, also as one number.

#include <Eigen/Core>
#include <cstdint>

#include "common/geometry/floor.hpp"
#include "common/geometry/grid_key.hpp"
#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Cube (i, j, k) spans [i, i + 1) * edge on x, likewise y and z.
using GridIndex = Eigen::Matrix<std::int64_t, 3, 1>;

inline GridIndex grid_index(const Eigen::Vector3d& point, double edge_m) {
  const Eigen::Vector3d edges = point / edge_m;
  return {floor_to<std::int64_t>(edges.x()), floor_to<std::int64_t>(edges.y()),
          floor_to<std::int64_t>(edges.z())};
}

inline TileIndex tile_index(const Eigen::Vector3d& point_map, double edge_m) {
  const Eigen::Vector3i index = grid_index(point_map, edge_m).cast<std::int32_t>();
  return {index.x(), index.y(), index.z()};
}

/// Whether a point certainly lies within a row of cubes, a micrometre from its faces. Cheaper than
/// the divisions of tile_index, so it is asked first. False for NaN.
inline bool lies_well_within(const Eigen::Vector3d& point_map, const TileIndex& first,
                             const TileIndex& last, double edge_m) {
  constexpr double kMargin_m = 1e-6;
  const auto within = [&](double at_m, int from, int to) {
    return at_m > from * edge_m + kMargin_m && at_m < (to + 1.0) * edge_m - kMargin_m;
  };
  return within(point_map.x(), first.i, last.i) && within(point_map.y(), first.j, last.j) &&
         within(point_map.z(), first.k, last.k);
}

inline Eigen::Vector3d centre_of(const GridIndex& index, double edge_m) {
  return (index.cast<double>() + Eigen::Vector3d::Constant(0.5)) * edge_m;
}

/// Whether pack_key() gives the cube a key of its own.
inline bool has_key(const GridIndex& index) {
  return index.minCoeff() >= -kGridKeyOffset && index.maxCoeff() < kGridKeyOffset;
}

inline std::uint64_t pack_key(const GridIndex& index) {
  return grid_key(index.x(), index.y(), index.z());
}

inline GridIndex unpack_key(std::uint64_t key) {
  const auto [i, j, k] = grid_indices(key);
  return {i, j, k};
}

}  // namespace zloam::mapping
