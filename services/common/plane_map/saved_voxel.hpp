#pragma once
// A voxel of the plane map as it is stored: its counts and its position.

#include <array>
#include <cstdint>

namespace zloam::plane_map {

struct SavedVoxel {
  /// the voxel spans [x, x + 1) * edge on x, likewise y and z, grid frame; edge = root >> level
  std::int32_t x = 0, y = 0, z = 0;
  std::uint32_t count = 0;
  /// 0: coarsest
  std::uint8_t level = 0;
  /// ring of most points by majority vote, and its lead over all others: count when there are no
  /// others, 0 when the rings are unknown
  std::uint16_t ring = 0;
  std::uint32_t lead = 0;
  /// of the points relative to the voxel's centre, m
  std::array<float, 3> sum{};
  /// xx xy xz yy yz zz, m^2
  std::array<float, 6> squares{};
};

/// One of the coarsest voxels. It has changed if its count has.
struct RootSummary {
  std::array<std::int32_t, 3> index{};
  std::uint32_t count = 0;
};

}  // namespace zloam::plane_map
