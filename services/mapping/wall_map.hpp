#pragma once
// Finds places in a whole map for a robot of which nothing is known: the walls around it, seen from
// above, are compared with the walls of the map at every place and heading. Branch and bound over
// maps of decreasing resolution finds the best places without testing all of them (Hess, Kohler,
// Rapp, Andor, Real-time loop closure in 2D LIDAR SLAM, ICRA 2016, section V).
//
// A wall is a column of points one above the other: flat surfaces look the same everywhere. Map and
// surroundings are levelled: their z axes are vertical. The map must be fixed.

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "common/geometry/se3.hpp"
#include "mapping/sweep_view.hpp"

namespace zloam::mapping {

/// What lies around a robot, for the search.
class Surroundings {
 public:
  /// points_level: around the robot, z up.
  explicit Surroundings(std::span<const Eigen::Vector3f> points_level);

 private:
  friend class WallMap;
  std::vector<Eigen::Vector3f> near_;
  // An even sample seen from above, and the range that contains most of it.
  std::vector<Eigen::Vector2f> walls_;
  float range_m_ = 0.0F;
};

class WallMap {
 public:
  /// points: frame map.
  explicit WallMap(std::span<const Eigen::Vector3f> points);

  /// Poses of the surroundings' frame at which most of their walls meet walls of the map, best
  /// first, at most `most`, none adjacent to another, and none with less than least_share of the
  /// walls that can be met. Empty where either has too few walls.
  std::vector<Pose> likely_places(const Surroundings& around, std::size_t most,
                                  double least_share = 0.0) const;
  /// That share for one pose.
  double share_at(const Surroundings& around, const Pose& T_map_level) const;

  /// The share of the map's walls in view of a sweep from this pose that it sees through.
  double seen_through(const SweepView& view, const Pose& T_map_lidar) const;

 private:
  // Maxima of the level before in squares of 2^level cells; (0, 0) is the square that ends with the
  // grid's first cell.
  struct Level {
    int width = 0, height = 0;
    std::vector<std::uint8_t> values;
  };
  struct Pyramid {
    float cell_m = 0.0F;
    std::vector<Level> levels;
  };
  struct Node {
    std::uint32_t score = 0;
    std::int32_t x = 0, y = 0;
    std::int16_t turn = 0;
    std::int8_t level = 0;
  };
  // By row first. A map of 40 km has more columns than a number of 32 bits can count.
  struct ColumnIndex {
    std::int32_t y, x;
    auto operator<=>(const ColumnIndex&) const = default;
  };
  struct Column {
    ColumnIndex cell;
    std::int32_t height;
    auto operator<=>(const Column&) const = default;
  };
  using Cells = std::vector<Eigen::Vector2i>;

  static Pyramid pyramid_of(std::span<const Eigen::Vector2f> walls, const Eigen::Vector2f& size_m,
                            float cell_m);
  static std::uint32_t score(const Level& level, const Cells& cells, int x, int y, int first);
  static std::vector<Node> search(const Pyramid& pyramid, const std::vector<Cells>& turned,
                                  std::size_t most, double least_share);
  const Pyramid& pyramid_for(const Surroundings& around) const;
  static Cells turned_by(int turn, const Surroundings& around, float cell_m);
  void keep_heights(std::span<const Eigen::Vector3f> points);
  double height_of(std::span<const Eigen::Vector3f> points_level, const Pose& place) const;

  Eigen::Vector2f origin_ = Eigen::Vector2f::Zero();
  std::int32_t width_ = 0, height_ = 0;
  // Finest first.
  std::vector<Pyramid> pyramids_;
  // Points of walls, by column.
  std::vector<std::pair<ColumnIndex, Eigen::Vector3f>> wall_points_;
  // Heights of points in each column of the map, ascending.
  std::vector<Column> columns_;
};

}  // namespace zloam::mapping
