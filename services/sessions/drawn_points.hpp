#pragma once
// The points behind the sums of stored voxels, drawn again: as many, with the same mean and the
// same covariance. So a map's voxels can be counted again in another grid, after a motion that is
// not a multiple of their size.

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "common/plane_map/saved_voxel.hpp"

namespace zloam::sessions {

/// What one voxel has counted itself, and not in finer ones; frame of the voxels' grid.
struct Patch {
  std::uint32_t count = 0;
  /// as in SavedVoxel
  std::uint16_t ring = 0;
  std::uint32_t lead = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  /// principal axes times their sigmas, ascending
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
};

/// The patches of one cube, in its order: parents before children.
std::vector<Patch> patches_of(std::span<const plane_map::SavedVoxel> voxels, double root_voxel_m);

class UnitClouds {
 public:
  /// That many points with mean zero, spread evenly over a cube, the covariance being the unit
  /// matrix, or as much of it as so few points can have: that of the last axes.
  const std::vector<Eigen::Vector3d>& of(std::uint32_t count);

 private:
  std::vector<std::vector<Eigen::Vector3d>> clouds_;
};

}  // namespace zloam::sessions
