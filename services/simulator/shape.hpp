#pragma once
// The solids that worlds consist of, and the intersection of a ray with a solid. Frame world, m.

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>

namespace zloam::simulator {

enum class ShapeKind : std::uint8_t {
  kBox,        ///< half: half extents along the shape's axes
  kCylinder,   ///< half: radius, radius, half height; the axis is the shape's z; no caps
  kEllipsoid,  ///< half: semi-axes
};

/// One solid. A shape with density > 0 is foliage: it is filled with small spherical leaves at
/// fixed places, so many that a ray stops within a depth with probability
/// 1 - exp(-density * depth).
struct Shape {
  ShapeKind kind = ShapeKind::kBox;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector3d half = Eigen::Vector3d::Ones();
  Eigen::Matrix3d R_world_shape = Eigen::Matrix3d::Identity();
  double reflectivity = 60.0;  ///< 0-100 diffuse, 101-255 retro-reflector
  double density_per_m = 0.0;
  double roughness_m = 0.0;  ///< 1 sigma of the surface's relief, bumps of some 5 cm
};

struct Ray {
  Eigen::Vector3d origin;     ///< m
  Eigen::Vector3d direction;  ///< unit
};

/// Where a ray meets a surface.
struct Crossing {
  double range_m;
  double cos_incidence;  ///< 0 (grazing) to 1 (perpendicular)
};

/// Crossings nearer than this are ignored: they would be inside the sensor's housing.
inline constexpr double kNearestHitM = 0.05;

/// First crossing of the ray with the shape beyond kNearestHitM; from inside, that with the far
/// wall. shape_index selects the shape's own leaves. Crossings beyond max_range_m may be omitted.
std::optional<Crossing> cross(const Ray& ray, const Shape& shape, std::uint64_t shape_index,
                              double max_range_m = std::numeric_limits<double>::infinity());

/// The range that the shape's roughness adds for a ray that hits the point: 0 for smooth shapes,
/// else a fixed value for each place, with a sigma of roughness / cos_incidence.
double relief_along(const Eigen::Vector3d& point, const Shape& shape, std::uint64_t shape_index,
                    double cos_incidence);

/// Half extents of the axis-aligned box around the shape.
Eigen::Vector3d half_bounds(const Shape& shape);

/// Unsigned distance of a point from the shape's surface, exact for boxes and cylinders near their
/// faces and first-order for ellipsoids. For tests and clearance checks.
double distance_to_surface(const Eigen::Vector3d& point, const Shape& shape);

}  // namespace zloam::simulator
