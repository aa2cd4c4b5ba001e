#pragma once
// A world: solids and ground, with ray-casting through a bounding volume hierarchy.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "simulator/moving.hpp"
#include "simulator/shape.hpp"
#include "simulator/terrain.hpp"

namespace zloam::simulator {

inline constexpr int kNoSurface = -1;
inline constexpr int kGround = -2;

/// The first surface that a ray hits.
struct Hit {
  double range_m = 0.0;
  double cos_incidence = 0.0;
  double reflectivity = 0.0;
  /// Index into World::shapes(), followed by the shapes of World::movers() in their order; or
  /// kGround or kNoSurface.
  int surface = kNoSurface;

  explicit operator bool() const { return surface != kNoSurface; }
};

/// Immutable after construction, so that threads may share it.
class World {
 public:
  /// Terrain may be absent (floors can be boxes).
  World(std::vector<Shape> shapes, std::optional<Terrain> terrain, std::vector<Mover> movers = {});

  const std::vector<Shape>& shapes() const { return shapes_; }
  const std::optional<Terrain>& terrain() const { return terrain_; }

  const std::vector<Mover>& movers() const { return movers_; }

  /// All moving shapes at their places at a time (s).
  std::vector<MovingShape> moving_at(double time_s) const;
  /// Appends the shapes of one mover at a time (s).
  void add_moving(std::size_t mover, double time_s, std::vector<MovingShape>& out) const;
  /// Radius of the sphere around a mover's place that contains all of its shapes, m.
  double mover_radius(std::size_t mover) const { return radii_[mover]; }

  /// The nearest surface within max_range_m, including the relief of rough ones. Of the moving
  /// shapes only those in `moving` count, moved on by after_s at their velocities.
  Hit cast(const Ray& ray, double max_range_m, std::span<const MovingShape> moving = {},
           double after_s = 0.0) const;

 private:
  struct Node {
    Eigen::Vector3f low;
    Eigen::Vector3f high;
    std::int32_t first;  // leaf: first of the shapes; else index of the second child
    std::int32_t count;  // leaf: number of shapes; else 0
    std::int32_t axis;   // inner node: axis along which the children are sorted
  };
  void measure_movers();
  void build(std::int32_t begin, std::int32_t end, int depth);
  void cast_shapes(const Ray& ray, Hit& best) const;
  void cast_leaf(const Ray& ray, const Node& node, Hit& best) const;

  std::vector<Shape> shapes_;
  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
  std::optional<Terrain> terrain_;
  std::vector<Mover> movers_;
  std::vector<int> first_surface_;  // number of each mover's first surface
  std::vector<double> radii_;
};

}  // namespace zloam::simulator
