#pragma once
// Builds worlds from solids that are placed upright on the ground and kept clear of the path.

#include <Eigen/Core>
#include <vector>

#include "simulator/path.hpp"
#include "simulator/shape.hpp"
#include "simulator/terrain.hpp"

namespace zloam::simulator {

/// An upright box: centre (m), extents along its own axes (m), rotation about the vertical (rad).
struct BoxSpec {
  double x, y, z_low, z_high, length, width, yaw;
  double reflectivity = 60.0;
};

/// An axis-aligned rectangle in the plane, m.
struct Rectangle {
  double x_low, y_low, x_high, y_high;
};

class SceneBuilder {
 public:
  /// Solids placed with try_* stay at least clearance_m away from the path.
  void keep_clear(const Path& path, double clearance_m);

  Shape& box(const BoxSpec& spec);
  Shape& cylinder(double x, double y, double radius, double z_low, double z_high,
                  double reflectivity);
  /// A tube along the world's x axis, to be seen from inside.
  Shape& tube_x(const Eigen::Vector3d& centre, double radius, double length, double reflectivity);
  Shape& ellipsoid(const Eigen::Vector3d& centre, const Eigen::Vector3d& half, double reflectivity);

  /// The same, unless the solid would obstruct the path: then nothing is placed and the result is
  /// false.
  bool try_box(const BoxSpec& spec);
  bool try_cylinder(double x, double y, double radius, double z_low, double z_high,
                    double reflectivity);

  /// Whether the upright box keeps its distance from the path.
  bool is_clear(const BoxSpec& spec) const;

  /// Places walls along the outline of the union of the rectangles, outside of it.
  void walls_around(const std::vector<Rectangle>& free, double height, double thickness,
                    double reflectivity);

  /// Lifts every solid placed so far by the ground's height below its centre.
  void lift_onto(const Terrain& ground);

  std::vector<Shape> take() { return std::move(shapes_); }

 private:
  std::vector<Shape> shapes_;
  Polyline path_;
  double clearance_ = 0.0;
};

/// Rotation about the vertical.
Eigen::Matrix3d turned(double yaw_rad);

/// Visits places along a line, from `first` on and step() apart, up to `end`.
template <class Step, class Visit>
void along_line(double first, double end, Step step, Visit visit) {
  double place = first;
  while (place < end) {
    visit(place);
    place += step();
  }
}

}  // namespace zloam::simulator
