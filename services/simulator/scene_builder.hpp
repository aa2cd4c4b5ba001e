#pragma once
// What the worlds are put together with: solids placed upright on the ground, kept off the path.

#include <Eigen/Core>
#include <vector>

#include "simulator/path.hpp"
#include "simulator/shape.hpp"
#include "simulator/terrain.hpp"

namespace zloam::simulator {

/// Centre (m), extents along its own axes (m) and turn about the vertical (rad) of an upright box.
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
  /// Nothing that is placed with try_* comes nearer to the path than clearance_m.
  void keep_clear(const Path& path, double clearance_m);

  Shape& box(const BoxSpec& spec);
  Shape& cylinder(double x, double y, double radius, double z_low, double z_high,
                  double reflectivity);
  /// A tube along the x axis of its own frame, seen from inside: half height along the axis.
  Shape& tube_x(const Eigen::Vector3d& centre, double radius, double length, double reflectivity);
  Shape& ellipsoid(const Eigen::Vector3d& centre, const Eigen::Vector3d& half, double reflectivity);

  /// The same, but false and nothing placed where the path would be obstructed.
  bool try_box(const BoxSpec& spec);
  bool try_cylinder(double x, double y, double radius, double z_low, double z_high,
                    double reflectivity);

  /// Whether the upright box keeps its distance from the path.
  bool is_clear(const BoxSpec& spec) const;

  /// Walls along the outline of the union of the rectangles, outside of it.
  void walls_around(const std::vector<Rectangle>& free, double height, double thickness,
                    double reflectivity);

  /// Sets everything that was placed so far onto uneven ground, by the height below its centre.
  void lift_onto(const Terrain& ground);

  std::vector<Shape> take() { return std::move(shapes_); }

 private:
  std::vector<Shape> shapes_;
  Polyline path_;
  double clearance_ = 0.0;
};

/// Rotation about the vertical.
Eigen::Matrix3d turned(double yaw_rad);

/// Goes along a line from the first place on, step() further each time, while before the end.
template <class Step, class Visit>
void along_line(double first, double end, Step step, Visit visit) {
  double place = first;
  while (place < end) {
    visit(place);
    place += step();
  }
}

}  // namespace zloam::simulator
