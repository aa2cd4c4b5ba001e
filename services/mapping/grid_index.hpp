#pragma once
// Which cube of a regular grid a point lies in, and that as one number.

#include <Eigen/Core>
#include <cstdint>

#include "mapping/mapping.hpp"

namespace zloam::mapping {

/// Cube (i, j, k) spans [i, i + 1) * edge on x, likewise y and z.
using GridIndex = Eigen::Matrix<std::int64_t, 3, 1>;

inline GridIndex grid_index(const Eigen::Vector3d& point, double edge_m) {
  return (point / edge_m).array().floor().cast<std::int64_t>().matrix();
}

inline TileIndex tile_index(const Eigen::Vector3d& point_map, double edge_m) {
  const Eigen::Vector3i index = grid_index(point_map, edge_m).cast<std::int32_t>();
  return {index.x(), index.y(), index.z()};
}

inline Eigen::Vector3d centre_of(const GridIndex& index, double edge_m) {
  return (index.cast<double>() + Eigen::Vector3d::Constant(0.5)) * edge_m;
}

constexpr int kKeyBits = 21;
constexpr std::int64_t kKeyOffset = std::int64_t{1} << (kKeyBits - 1);
constexpr std::uint64_t kKeyMask = (std::uint64_t{1} << kKeyBits) - 1;

/// Indices of -2^20 to 2^20 - 1 have keys of their own.
inline std::uint64_t pack_key(std::int64_t i, std::int64_t j, std::int64_t k) {
  const auto part = [](std::int64_t n) {
    return static_cast<std::uint64_t>(n + kKeyOffset) & kKeyMask;
  };
  return part(i) << (2 * kKeyBits) | part(j) << kKeyBits | part(k);
}
inline std::uint64_t pack_key(const GridIndex& index) {
  return pack_key(index.x(), index.y(), index.z());
}

inline GridIndex unpack_key(std::uint64_t key) {
  const auto part = [key](int n) {
    return static_cast<std::int64_t>(key >> (n * kKeyBits) & kKeyMask) - kKeyOffset;
  };
  return {part(2), part(1), part(0)};
}

}  // namespace zloam::mapping
