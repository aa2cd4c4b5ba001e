#include "simulator/shape.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;

// The part of a line inside a convex solid, with the normals (shape frame) at both ends.
struct Span {
  double enter;
  double leave;
  Vector3d enter_normal;
  Vector3d leave_normal;
};

std::optional<Span> box_span(const Vector3d& o, const Vector3d& d, const Vector3d& half) {
  double enter = -std::numeric_limits<double>::infinity();
  double leave = std::numeric_limits<double>::infinity();
  int enter_axis = 0;
  int leave_axis = 0;
  for (int axis = 0; axis < 3; ++axis) {
    if (std::abs(d[axis]) < 1e-12) {
      if (std::abs(o[axis]) > half[axis]) {
        return std::nullopt;
      }
      continue;
    }
    const double inverse = 1.0 / d[axis];
    const double reach = half[axis] * std::abs(inverse);
    const double middle = -o[axis] * inverse;
    if (middle - reach > enter) {
      enter = middle - reach;
      enter_axis = axis;
    }
    if (middle + reach < leave) {
      leave = middle + reach;
      leave_axis = axis;
    }
  }
  if (enter >= leave) {
    return std::nullopt;
  }
  return Span{enter, leave, Vector3d::Unit(enter_axis), Vector3d::Unit(leave_axis)};
}

std::optional<Span> ellipsoid_span(const Vector3d& o, const Vector3d& d, const Vector3d& half) {
  const Vector3d os = o.cwiseQuotient(half);
  const Vector3d ds = d.cwiseQuotient(half);
  const double a = ds.squaredNorm();
  const double b = os.dot(ds);
  const double discriminant = b * b - a * (os.squaredNorm() - 1.0);
  if (discriminant <= 0.0) {
    return std::nullopt;
  }
  const double root = std::sqrt(discriminant);
  const double enter = (-b - root) / a;
  const double leave = (-b + root) / a;
  const auto normal = [&](double t) -> Vector3d {
    return (os + t * ds).cwiseQuotient(half).normalized();
  };
  return Span{enter, leave, normal(enter), normal(leave)};
}

std::optional<Crossing> crossing_at(double range, const Vector3d& d, const Vector3d& normal) {
  return Crossing{range, std::abs(d.dot(normal))};
}

// The mantle only: what is seen of a pole, a tank, a pipe or the inside of a vault.
std::optional<Crossing> cross_cylinder(const Vector3d& o, const Vector3d& d, const Vector3d& half) {
  const double a = d.head<2>().squaredNorm();
  if (a < 1e-12) {
    return std::nullopt;
  }
  const double b = o.head<2>().dot(d.head<2>());
  const double discriminant = b * b - a * (o.head<2>().squaredNorm() - half.x() * half.x());
  if (discriminant <= 0.0) {
    return std::nullopt;
  }
  const double root = std::sqrt(discriminant);
  for (const double range : {(-b - root) / a, (-b + root) / a}) {
    const Vector3d p = o + range * d;
    if (range > kNearestHitM && std::abs(p.z()) <= half.z()) {
      return crossing_at(range, d, Vector3d(p.x(), p.y(), 0.0) / half.x());
    }
  }
  return std::nullopt;
}

std::optional<Crossing> cross_foliage(const Span& span, double density, std::uint64_t key) {
  const double start = std::max(span.enter, 0.0);
  Random random(key, Stream::kReturns);
  const double range = start - std::log(1.0 - random.uniform()) / density;
  if (range >= span.leave || range <= kNearestHitM) {
    return std::nullopt;
  }
  return Crossing{range, random.uniform(0.3, 1.0)};
}

}  // namespace

std::optional<Crossing> cross(const Ray& ray, const Shape& shape, std::uint64_t shape_index) {
  const Vector3d o = shape.R_world_shape.transpose() * (ray.origin - shape.centre);
  const Vector3d d = shape.R_world_shape.transpose() * ray.direction;
  if (shape.kind == ShapeKind::kCylinder) {
    return cross_cylinder(o, d, shape.half);
  }
  const auto span =
      shape.kind == ShapeKind::kBox ? box_span(o, d, shape.half) : ellipsoid_span(o, d, shape.half);
  if (!span || span->leave <= kNearestHitM) {
    return std::nullopt;
  }
  if (shape.density_per_m > 0.0) {
    return cross_foliage(*span, shape.density_per_m, ray.key ^ mixed(shape_index));
  }
  if (span->enter > kNearestHitM) {
    return crossing_at(span->enter, d, span->enter_normal);
  }
  return crossing_at(span->leave, d, span->leave_normal);
}

Vector3d half_bounds(const Shape& shape) { return shape.R_world_shape.cwiseAbs() * shape.half; }

double distance_to_surface(const Vector3d& point, const Shape& shape) {
  const Vector3d p = shape.R_world_shape.transpose() * (point - shape.centre);
  if (shape.kind == ShapeKind::kCylinder) {
    const double radial = p.head<2>().norm() - shape.half.x();
    const double above = std::max(std::abs(p.z()) - shape.half.z(), 0.0);
    return std::hypot(radial, above);
  }
  if (shape.kind == ShapeKind::kEllipsoid) {
    const double k0 = p.cwiseQuotient(shape.half).norm();
    const double k1 = p.cwiseQuotient(shape.half.cwiseAbs2()).norm();
    return k1 > 0.0 ? std::abs(k0 * (k0 - 1.0) / k1) : shape.half.minCoeff();
  }
  const Vector3d q = p.cwiseAbs() - shape.half;
  const double inside = std::min(q.maxCoeff(), 0.0);
  return std::abs(q.cwiseMax(0.0).norm() + inside);
}

}  // namespace zloam::simulator
