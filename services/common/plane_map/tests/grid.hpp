#pragma once
// A grid along the axes, so that a test knows which voxel a point lies in.

#include "common/plane_map/config.hpp"

namespace zloam::plane_map::testing {

inline PlaneMapConfig upright_grid() {
  PlaneMapConfig config;
  config.grid_rotation_rad.setZero();
  config.grid_shift_m.setZero();
  return config;
}

}  // namespace zloam::plane_map::testing
