#pragma once
// The solids of which worlds are made, and the intersection of a ray with one of them. Frame:
// world, metres.

#include <Eigen/Core>
#include <cstdint>
#include <optional>

namespace zloam::simulator {

enum class ShapeKind : std::uint8_t {
  kBox,        ///< half: half extents along the shape's axes
  kCylinder,   ///< half: radius, radius, half height; the axis is the shape's z; no caps
  kEllipsoid,  ///< half: semi-axes
};

/// One solid. A shape with density > 0 is foliage: a ray stops at a random depth inside it, with
/// the probability density * exp(-density * depth), or leaves it at the far side.
struct Shape {
  ShapeKind kind = ShapeKind::kBox;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d half = Eigen::Vector3d::Ones();
  Eigen::Matrix3d R_world_shape = Eigen::Matrix3d::Identity();
  double reflectivity = 60.0;  ///< 0-100 diffuse, 101-255 retro-reflector
  double density_per_m = 0.0;
  double roughness_m = 0.0;  ///< 1 sigma of the surface's own relief along the beam
};

struct Ray {
  Eigen::Vector3d origin;     ///< m
  Eigen::Vector3d direction;  ///< unit
  std::uint64_t key = 0;      ///< decides the random depths in foliage
};

/// Where a ray meets a surface.
struct Crossing {
  double range_m;
  double cos_incidence;  ///< 0 (grazing) to 1 (perpendicular)
};

/// Nothing is nearer to the sensor than its own housing, so shapes nearer than this are not seen.
inline constexpr double kNearestHitM = 0.05;

/// First crossing of the ray with the shape beyond kNearestHitM; seen from inside, the far wall.
std::optional<Crossing> cross(const Ray& ray, const Shape& shape, std::uint64_t shape_index);

/// Half extents of the axis-aligned box around the shape.
Eigen::Vector3d half_bounds(const Shape& shape);

/// Unsigned distance of a point from the shape's surface, exact for boxes and cylinders near their
/// faces and first-order for ellipsoids. For tests and clearance checks.
double distance_to_surface(const Eigen::Vector3d& point, const Shape& shape);

}  // namespace zloam::simulator
