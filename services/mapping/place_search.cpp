#include "mapping/place_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "mapping/tile_map.hpp"
#include "mapping/voxel_filter.hpp"

namespace zloam::mapping {
namespace {

// Edge of the map's cells and step of the search; both are doubled for a search beyond kWide_m.
constexpr double kCell_m = 0.5, kWide_m = 10.0;
constexpr double kTurn_rad = 0.05;
// Number of vertical steps, both up and down.
constexpr int kUp = 2;
// Farther points are left out: at this range a step of the heading moves a point by 1.5 m.
constexpr double kFarthest_m = 30.0;
constexpr double kHighest_m = 12.0;
// The sweep is reduced to one point per voxel of this size, and thinned to fewer than twice
// kMostPoints.
constexpr double kLeaf_m = 1.0;
constexpr std::size_t kMostPoints = 300;
// Score of an occupied cell and of its neighbours: the right place lies between places of the grid.
constexpr std::uint8_t kHit = 2, kBeside = 1;
// Minimum score of a place as a share of the best score.
constexpr double kWorth = 0.5;

struct Scored {
  std::uint32_t score;
  std::int16_t turn, x, y, z;
};

/// Occupied cells around a place, wide enough for all points at all places of a search.
class Cells {
 public:
  Cells(const Eigen::Vector3d& centre, double cell_m, int steps)
      : cell_m_(cell_m),
        half_(static_cast<int>(std::ceil(kFarthest_m / cell_m)) + steps + 2),
        half_z_(static_cast<int>(std::ceil(kHighest_m / cell_m)) + kUp + 1),
        origin_(centre),
        values_(static_cast<std::size_t>(2 * half_) * static_cast<std::size_t>(2 * half_) *
                static_cast<std::size_t>(2 * half_z_)) {}

  void occupy(const Eigen::Vector3d& point_map) {
    const Eigen::Vector3d at = (point_map - origin_) / cell_m_;
    const Eigen::Vector3i cell = at.array().floor().cast<int>();
    // One cell of margin, as the neighbouring cells are marked too.
    if (cell.head<2>().cwiseAbs().maxCoeff() >= half_ - 1) return;
    if (std::abs(cell.z()) >= half_z_ - 1) return;
    for (const int dx : {-1, 0, 1}) {
      for (const int dy : {-1, 0, 1}) {
        std::uint8_t& value = values_[index(cell + Eigen::Vector3i(dx, dy, 0))];
        value = std::max(value, dx == 0 && dy == 0 ? kHit : kBeside);
      }
    }
  }

  /// Index of the cell that contains a point, which is given relative to the centre.
  std::int32_t index_of(const Eigen::Vector3d& offset) const {
    return static_cast<std::int32_t>(
        index((offset / cell_m_).array().floor().matrix().cast<int>()));
  }
  /// Change of the index with one step along x, and along y.
  std::int32_t step_x() const { return 4 * half_ * half_z_; }
  std::int32_t step_y() const { return 2 * half_z_; }
  const std::uint8_t* values() const { return values_.data(); }

 private:
  std::size_t index(const Eigen::Vector3i& cell) const {
    const Eigen::Vector3i i = cell + Eigen::Vector3i(half_, half_, half_z_);
    return (static_cast<std::size_t>(i.x()) * static_cast<std::size_t>(2 * half_) +
            static_cast<std::size_t>(i.y())) *
               static_cast<std::size_t>(2 * half_z_) +
           static_cast<std::size_t>(i.z());
  }

  double cell_m_;
  int half_, half_z_;
  Eigen::Vector3d origin_;
  std::vector<std::uint8_t> values_;
};

/// The thinned points of the sweep relative to the guess's position, in the map's axes.
std::vector<Eigen::Vector3d> points_at(const MappingInput& input, const Pose& guess) {
  std::vector<Eigen::Vector3d> points;
  for (const PointSpan layer : {input.edges, input.planes}) {
    for (const Eigen::Vector3d& p : voxel_means(layer, kLeaf_m)) {
      const Eigen::Vector3d turned = guess.linear() * p;
      const bool near = p.squaredNorm() < kFarthest_m * kFarthest_m;
      if (near && std::abs(turned.z()) < kHighest_m) points.push_back(turned);
    }
  }
  const std::size_t stride = std::max<std::size_t>(1, points.size() / kMostPoints);
  for (std::size_t i = 0; i * stride < points.size(); ++i) points[i] = points[i * stride];
  points.resize((points.size() + stride - 1) / stride);
  return points;
}

Cells cells_of(const TileMap& tiles, const Eigen::Vector3d& centre, double cell_m, int steps) {
  Cells cells(centre, cell_m, steps);
  for (const TileId& id : tiles.local_tiles()) {
    const std::optional<Tile> tile = tiles.tile(id);
    if (!tile) continue;
    for (const MapPoint& p : tile->points) cells.occupy(Eigen::Vector3d(p.x, p.y, p.z));
  }
  return cells;
}

Eigen::Matrix3d turned_by(int turn) {
  return Eigen::AngleAxisd(turn * kTurn_rad, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

/// Scores all places of one heading.
void score(const Cells& cells, const std::vector<Eigen::Vector3d>& points, int turn, int steps,
           std::vector<Scored>& out) {
  std::vector<std::int32_t> indices;
  indices.reserve(points.size());
  const Eigen::Matrix3d R = turned_by(turn);
  for (const Eigen::Vector3d& p : points) indices.push_back(cells.index_of(R * p));
  const std::uint8_t* values = cells.values();
  for (int x = -steps; x <= steps; ++x) {
    for (int y = -steps; y <= steps; ++y) {
      for (int z = -kUp; z <= kUp; ++z) {
        const std::int32_t shift = x * cells.step_x() + y * cells.step_y() + z;
        std::uint32_t sum = 0;
        for (const std::int32_t i : indices) sum += values[i + shift];
        out.push_back({sum, static_cast<std::int16_t>(turn), static_cast<std::int16_t>(x),
                       static_cast<std::int16_t>(y), static_cast<std::int16_t>(z)});
      }
    }
  }
}

bool is_next_to(const Scored& a, const Scored& b) {
  return std::abs(a.x - b.x) <= 1 && std::abs(a.y - b.y) <= 1 && std::abs(a.turn - b.turn) <= 1;
}

/// The best places, none adjacent to another; places of equal score keep their order.
std::vector<Scored> best_of(std::vector<Scored> all, std::size_t most) {
  std::uint32_t highest = 0;
  for (const Scored& s : all) highest = std::max(highest, s.score);
  std::erase_if(all, [highest](const Scored& s) { return s.score < kWorth * highest; });
  std::stable_sort(all.begin(), all.end(),
                   [](const Scored& a, const Scored& b) { return a.score > b.score; });
  std::vector<Scored> best;
  for (const Scored& s : all) {
    if (best.size() == most) break;
    const bool is_new = std::none_of(best.begin(), best.end(),
                                     [&](const Scored& other) { return is_next_to(s, other); });
    if (is_new) best.push_back(s);
  }
  return best;
}

}  // namespace

std::vector<Pose> likely_places(const TileMap& tiles, const MappingInput& input, const Pose& guess,
                                const SearchArea& area, std::size_t most) {
  const std::vector<Eigen::Vector3d> points = points_at(input, guess);
  if (points.empty() || tiles.point_count() == 0) return {};
  const double cell_m = area.distance_m > kWide_m ? 2.0 * kCell_m : kCell_m;
  const int steps = static_cast<int>(std::ceil(area.distance_m / cell_m));
  const int turns = static_cast<int>(std::ceil(area.rotation_rad / kTurn_rad));
  const Cells cells = cells_of(tiles, guess.translation(), cell_m, steps);
  std::vector<Scored> all;
  for (int turn = -turns; turn <= turns; ++turn) score(cells, points, turn, steps, all);
  std::vector<Pose> places;
  for (const Scored& s : best_of(std::move(all), most)) {
    Pose place = guess;
    place.linear() = turned_by(s.turn) * guess.linear();
    place.translation() += cell_m * Eigen::Vector3d(s.x, s.y, s.z);
    places.push_back(place);
  }
  return places;
}

}  // namespace zloam::mapping
