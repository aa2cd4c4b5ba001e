#include "simulator/scene_builder.hpp"

#include <algorithm>
#include <cmath>

namespace zloam::simulator {

using Eigen::Vector2d;
using Eigen::Vector3d;

Eigen::Matrix3d turned(double yaw_rad) {
  const double c = std::cos(yaw_rad);
  const double s = std::sin(yaw_rad);
  Eigen::Matrix3d rotation;
  rotation << c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0;
  return rotation;
}

void SceneBuilder::keep_clear(const Path& path, double clearance_m) {
  constexpr std::size_t kEvery = 20;  // path points are 1 cm apart
  clearance_ = clearance_m;
  for (std::size_t i = 0; i < path.points.size(); i += kEvery) {
    path_.push_back(path.points[i]);
  }
}

bool SceneBuilder::is_clear(const BoxSpec& spec) const {
  const Eigen::Matrix2d R_box_world = turned(-spec.yaw).topLeftCorner<2, 2>();
  return std::none_of(path_.begin(), path_.end(), [&](const Vector2d& p) {
    const Vector2d q = (R_box_world * (p - Vector2d(spec.x, spec.y))).cwiseAbs();
    return (q - Vector2d(spec.length, spec.width) / 2.0).cwiseMax(0.0).norm() < clearance_;
  });
}

Shape& SceneBuilder::box(const BoxSpec& spec) {
  Shape shape;
  shape.kind = ShapeKind::kBox;
  shape.centre = {spec.x, spec.y, (spec.z_low + spec.z_high) / 2.0};
  shape.half = {spec.length / 2.0, spec.width / 2.0, (spec.z_high - spec.z_low) / 2.0};
  shape.R_world_shape = turned(spec.yaw);
  shape.reflectivity = spec.reflectivity;
  return shapes_.emplace_back(shape);
}

Shape& SceneBuilder::cylinder(double x, double y, double radius, double z_low, double z_high,
                              double reflectivity) {
  Shape shape;
  shape.kind = ShapeKind::kCylinder;
  shape.centre = {x, y, (z_low + z_high) / 2.0};
  shape.half = {radius, radius, (z_high - z_low) / 2.0};
  shape.reflectivity = reflectivity;
  return shapes_.emplace_back(shape);
}

Shape& SceneBuilder::tube_x(const Vector3d& centre, double radius, double length,
                            double reflectivity) {
  Shape shape;
  shape.kind = ShapeKind::kCylinder;
  shape.centre = centre;
  shape.half = {radius, radius, length / 2.0};
  shape.R_world_shape << 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0;
  shape.reflectivity = reflectivity;
  return shapes_.emplace_back(shape);
}

Shape& SceneBuilder::ellipsoid(const Vector3d& centre, const Vector3d& half, double reflectivity) {
  Shape shape;
  shape.kind = ShapeKind::kEllipsoid;
  shape.centre = centre;
  shape.half = half;
  shape.reflectivity = reflectivity;
  return shapes_.emplace_back(shape);
}

void SceneBuilder::lift_onto(const Terrain& ground) {
  for (Shape& shape : shapes_) {
    shape.centre.z() += ground.height(shape.centre.x(), shape.centre.y());
  }
}

bool SceneBuilder::try_box(const BoxSpec& spec) {
  if (!is_clear(spec)) {
    return false;
  }
  box(spec);
  return true;
}

bool SceneBuilder::try_cylinder(double x, double y, double radius, double z_low, double z_high,
                                double reflectivity) {
  if (!is_clear({x, y, z_low, z_high, 2.0 * radius, 2.0 * radius, 0.0, reflectivity})) {
    return false;
  }
  cylinder(x, y, radius, z_low, z_high, reflectivity);
  return true;
}

namespace {

struct Interval {
  double low, high;
};

// The parts of the interval that remain after the given cuts.
std::vector<Interval> remainder_of(Interval whole, std::vector<Interval> cuts) {
  std::sort(cuts.begin(), cuts.end(),
            [](const Interval& a, const Interval& b) { return a.low < b.low; });
  std::vector<Interval> left;
  double from = whole.low;
  for (const Interval& cut : cuts) {
    if (cut.low > from) {
      left.push_back({from, std::min(cut.low, whole.high)});
    }
    from = std::max(from, cut.high);
  }
  if (from < whole.high) {
    left.push_back({from, whole.high});
  }
  std::erase_if(left, [](const Interval& i) { return i.high - i.low < 1e-6; });
  return left;
}

// The parts of a rectangle's side at position `at` (x if vertical, else y) that no other rectangle
// opens.
std::vector<Interval> closed_parts(const std::vector<Rectangle>& all, std::size_t self,
                                   bool vertical, double at, Interval side) {
  std::vector<Interval> cuts;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Rectangle& r = all[i];
    const Interval over = vertical ? Interval{r.x_low, r.x_high} : Interval{r.y_low, r.y_high};
    if (i != self && over.low <= at && at <= over.high) {
      cuts.push_back(vertical ? Interval{r.y_low, r.y_high} : Interval{r.x_low, r.x_high});
    }
  }
  return remainder_of(side, std::move(cuts));
}

}  // namespace

void SceneBuilder::walls_around(const std::vector<Rectangle>& free, double height, double thickness,
                                double reflectivity) {
  constexpr double kOutsideM = 1e-4;
  for (std::size_t i = 0; i < free.size(); ++i) {
    const Rectangle& r = free[i];
    const double middle = thickness / 2.0;
    for (const double side : {-1.0, 1.0}) {
      const double x = side < 0.0 ? r.x_low : r.x_high;
      for (const Interval& part :
           closed_parts(free, i, true, x + side * kOutsideM, {r.y_low, r.y_high})) {
        box({x + side * middle, (part.low + part.high) / 2.0, -0.2, height, thickness,
             part.high - part.low, 0.0, reflectivity});
      }
      const double y = side < 0.0 ? r.y_low : r.y_high;
      for (const Interval& part :
           closed_parts(free, i, false, y + side * kOutsideM, {r.x_low, r.x_high})) {
        box({(part.low + part.high) / 2.0, y + side * middle, -0.2, height, part.high - part.low,
             thickness, 0.0, reflectivity});
      }
    }
  }
}

}  // namespace zloam::simulator
