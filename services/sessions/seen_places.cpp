#include "sessions/seen_places.hpp"

#include <algorithm>
#include <array>
#include <cstdlib>

#include "common/geometry/floor.hpp"
#include "common/geometry/grid_key.hpp"

namespace zloam::sessions {
namespace {

// That of a submap's voxels.
constexpr double kCell_m = 0.3;
// Shells of cells around a place that are searched for points.
constexpr int kShells = 3;

std::array<std::int64_t, 3> cell_of(const Eigen::Vector3d& at) {
  return {floor_to<std::int64_t>(at.x() / kCell_m), floor_to<std::int64_t>(at.y() / kCell_m),
          floor_to<std::int64_t>(at.z() / kCell_m)};
}

/// Cells of which the farthest index is `shell` away.
template <class Take>
void around(const std::array<std::int64_t, 3>& cell, int shell, Take take) {
  for (int dx = -shell; dx <= shell; ++dx) {
    for (int dy = -shell; dy <= shell; ++dy) {
      const bool is_side = std::abs(dx) == shell || std::abs(dy) == shell;
      const int step = is_side || shell == 0 ? 1 : 2 * shell;
      for (int dz = -shell; dz <= shell; dz += step) {
        take(grid_key(cell[0] + dx, cell[1] + dy, cell[2] + dz));
      }
    }
  }
}

}  // namespace

void SeenPlaces::add(const Submap& submap, const std::vector<bool>& moving, std::size_t number) {
  for (std::size_t i = 0; i < submap.points.size(); ++i) {
    const MapPoint& p = submap.points[i];
    const auto cell = cell_of(submap.T_map_submap * Eigen::Vector3d(p.x, p.y, p.z));
    Votes& votes = cells_.try_emplace(grid_key(cell[0], cell[1], cell[2])).first->second;
    if (!moving[i] && votes.standing == 0) votes.first = number;
    ++(moving[i] ? votes.moving : votes.standing);
  }
}

std::optional<std::size_t> SeenPlaces::standing_at(const Eigen::Vector3d& at_map) const {
  const auto cell = cell_of(at_map);
  for (int shell = 0; shell <= kShells; ++shell) {
    Votes all;
    around(cell, shell, [&](std::uint64_t key) {
      const auto found = cells_.find(key);
      if (found == cells_.end()) return;
      const Votes& votes = found->second;
      const bool is_first = all.standing == 0 || votes.first < all.first;
      if (votes.standing > 0 && is_first) all.first = votes.first;
      all.standing += votes.standing;
      all.moving += votes.moving;
    });
    if (all.standing + all.moving == 0) continue;
    if (all.moving > all.standing) return std::nullopt;
    return all.first;
  }
  return std::nullopt;
}

}  // namespace zloam::sessions
