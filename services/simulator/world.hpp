#pragma once
// A world: solids and ground, with ray-casting through a bounding volume hierarchy.

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "simulator/shape.hpp"
#include "simulator/terrain.hpp"

namespace zloam::simulator {

inline constexpr int kNoSurface = -1;
inline constexpr int kGround = -2;

/// What a ray met first.
struct Hit {
  double range_m = 0.0;
  double cos_incidence = 0.0;
  double reflectivity = 0.0;
  double roughness_m = 0.0;
  int surface = kNoSurface;  ///< index into World::shapes(), kGround or kNoSurface

  explicit operator bool() const { return surface != kNoSurface; }
};

/// Immutable after construction, so that threads may share it.
class World {
 public:
  /// Terrain may be absent (floors can be boxes).
  World(std::vector<Shape> shapes, std::optional<Terrain> terrain);

  const std::vector<Shape>& shapes() const { return shapes_; }
  const std::optional<Terrain>& terrain() const { return terrain_; }

  /// The nearest surface within max_range_m.
  Hit cast(const Ray& ray, double max_range_m) const;

 private:
  struct Node {
    Eigen::Vector3f low;
    Eigen::Vector3f high;
    std::int32_t first;  // leaf: first of the shapes; else index of the second child
    std::int32_t count;  // leaf: number of shapes; else 0
    std::int32_t axis;   // inner: along which the children are sorted
  };
  void build(std::int32_t begin, std::int32_t end, int depth);
  void cast_shapes(const Ray& ray, Hit& best) const;
  void cast_leaf(const Ray& ray, const Node& node, Hit& best) const;

  std::vector<Shape> shapes_;
  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
  std::optional<Terrain> terrain_;
};

}  // namespace zloam::simulator
