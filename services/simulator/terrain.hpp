#pragma once
// Uneven ground: heights on a square grid, bilinear between its nodes.

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "simulator/shape.hpp"

namespace zloam::simulator {

/// The unevenness of the ground; with all values 0 it is the plane z = 0.
struct TerrainShape {
  double long_wave_m = 0.0;   ///< amplitude of hills with wave lengths of 30 to 90 m
  double short_wave_m = 0.0;  ///< amplitude of bumps with wave lengths of 4 to 12 m
  double relief_m = 0.0;      ///< amplitude of independent heights at the grid's nodes
};

class Terrain {
 public:
  /// Ground over the rectangle from low to high (m), with the given spacing of the grid.
  Terrain(const Eigen::Vector2d& low, const Eigen::Vector2d& high, double spacing_m,
          const TerrainShape& shape, std::uint64_t seed);

  /// Height in metres; beyond the rectangle, the height at its nearest edge.
  double height(double x, double y) const;

  /// First crossing from above within max_range_m. Sphere tracing with the greatest slope as bound
  /// (Hart, "Sphere tracing", The Visual Computer 1996), so that no bump is skipped.
  std::optional<Crossing> cross(const Ray& ray, double max_range_m) const;

  double reflectivity = 25.0;

 private:
  struct Local {
    double height;
    Eigen::Vector2d slope;
  };
  Local local(double x, double y) const;
  bool covers(double x, double y) const;
  void measure();

  Eigen::Vector2d low_;
  double spacing_;
  std::size_t columns_;
  std::size_t rows_;
  std::vector<float> heights_;
  double highest_ = 0.0;
  double steepest_ = 0.0;
};

}  // namespace zloam::simulator
