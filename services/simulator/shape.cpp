#include "simulator/shape.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;

// The part of a ray inside a convex solid, with the normals (shape frame) at both ends.
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

// The lateral surface only, without caps: enough for poles, tanks, pipes and vaults.
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

// A random number for each cell of a grid, always the same for the same cell.
std::uint64_t cell_bits(const Eigen::Vector3i& cell, std::uint64_t key) {
  const auto part = [](int v) { return static_cast<std::uint64_t>(static_cast<std::uint32_t>(v)); };
  return mixed(key + part(cell.x()) * 0x8DA6B343D8163841ULL +
               part(cell.y()) * 0xD8163841CB1AB31FULL + part(cell.z()) * 0xCB1AB31F8DA6B343ULL);
}

double unit(std::uint64_t bits, int shift) {
  return static_cast<double>((bits >> shift) & 0xFFFF) / 65536.0;
}

// A grid with at most one leaf per cell; a leaf is a sphere with a radius of 0.4 cells.
struct Leaves {
  double cell_m;
  std::uint64_t threshold;  // a cell has a leaf if its lowest 16 bits are below this
  std::uint64_t key;
};

constexpr double kLeafRadius = 0.4;  // share of the cell's edge

Leaves leaves_of(double density, std::uint64_t key) {
  // A ray that crosses a cell runs through 2/3 of its edge on average. If each cell had a leaf, the
  // share `mean` of such rays would hit it; a cell is without a leaf with probability 1 - share. So
  // mean * ln(1 - share) must be -density * 2/3 * edge.
  const double cell_m = std::min(0.1, 0.4 / density);
  const double chord_m = 2.0 / 3.0 * cell_m;
  const double mean = std::numbers::pi * kLeafRadius * kLeafRadius * 2.0 / 3.0;
  const double share = 1.0 - std::exp(-density * chord_m / mean);
  return {cell_m, static_cast<std::uint64_t>(share * 65536.0), key};
}

// Nearest crossing with the cell's leaf, if there is one. o and d are in units of cells.
std::optional<Crossing> cross_leaf(const Vector3d& o, const Vector3d& d,
                                   const Eigen::Vector3i& cell, const Leaves& leaves) {
  const std::uint64_t bits = cell_bits(cell, leaves.key);
  if ((bits & 0xFFFF) >= leaves.threshold) {
    return std::nullopt;
  }
  const double room = 1.0 - 2.0 * kLeafRadius;
  const Vector3d centre = cell.cast<double>() + Vector3d::Constant(kLeafRadius) +
                          room * Vector3d(unit(bits, 16), unit(bits, 32), unit(bits, 48));
  const Vector3d to = centre - o;
  const double along = to.dot(d);
  const double aside = to.squaredNorm() - along * along;
  const double radius_squared = kLeafRadius * kLeafRadius;
  if (aside >= radius_squared) {
    return std::nullopt;
  }
  const double half = std::sqrt(radius_squared - aside);
  return Crossing{along - half, half / kLeafRadius};
}

// Walks from cell to cell along the ray (Amanatides and Woo, "A fast voxel traversal algorithm for
// ray tracing", Eurographics 1987).
std::optional<Crossing> cross_foliage(const Vector3d& o_m, const Vector3d& d, const Span& span,
                                      const Leaves& leaves, double max_range_m) {
  const double start = std::max(span.enter, kNearestHitM) / leaves.cell_m;
  const double end = std::min(span.leave, max_range_m) / leaves.cell_m;
  const Vector3d o = o_m / leaves.cell_m;
  const Vector3d first = o + start * d;
  Eigen::Vector3i cell = first.array().floor().cast<int>();
  Eigen::Vector3i step;
  Vector3d next;
  Vector3d stride;
  for (int axis = 0; axis < 3; ++axis) {
    const bool flat = std::abs(d[axis]) < 1e-12;
    step[axis] = d[axis] < 0.0 ? -1 : 1;
    stride[axis] = flat ? std::numeric_limits<double>::infinity() : 1.0 / std::abs(d[axis]);
    const double edge = cell[axis] + (step[axis] > 0 ? 1.0 : 0.0);
    next[axis] = flat ? std::numeric_limits<double>::infinity() : (edge - o[axis]) / d[axis];
  }
  for (double t = start; t < end;) {
    const auto crossing = cross_leaf(o, d, cell, leaves);
    if (crossing && crossing->range_m >= start && crossing->range_m < end) {
      return Crossing{crossing->range_m * leaves.cell_m, crossing->cos_incidence};
    }
    int axis = next.x() < next.y() ? 0 : 1;
    axis = next.z() < next[axis] ? 2 : axis;
    t = next[axis];
    cell[axis] += step[axis];
    next[axis] += stride[axis];
  }
  return std::nullopt;
}

}  // namespace

std::optional<Crossing> cross(const Ray& ray, const Shape& shape, std::uint64_t shape_index,
                              double max_range_m) {
  // The ray misses most candidates of the tree. This test against the bounding sphere costs less
  // than transforming the ray.
  const Vector3d to = shape.centre - ray.origin;
  const double along = to.dot(ray.direction);
  if (to.squaredNorm() - along * along > shape.half.squaredNorm() * (1.0 + 1e-9)) {
    return std::nullopt;
  }
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
    return cross_foliage(o, d, *span, leaves_of(shape.density_per_m, mixed(shape_index)),
                         max_range_m);
  }
  if (span->enter > kNearestHitM) {
    return crossing_at(span->enter, d, span->enter_normal);
  }
  return crossing_at(span->leave, d, span->leave_normal);
}

double relief_along(const Vector3d& point, const Shape& shape, std::uint64_t shape_index,
                    double cos_incidence) {
  if (shape.roughness_m <= 0.0) {
    return 0.0;
  }
  constexpr double kCellM = 0.05;
  constexpr double kLeastCosine = 0.3;  // limits the relief at grazing incidence
  const Vector3d p = shape.R_world_shape.transpose() * (point - shape.centre) / kCellM;
  const Vector3d low = p.array().floor();
  const Vector3d u = p - low;
  const Eigen::Vector3i cell = low.cast<int>();
  double sum = 0.0;
  double squares = 0.0;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3i at(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
    double weight = 1.0;
    for (int axis = 0; axis < 3; ++axis) {
      weight *= at[axis] == 1 ? u[axis] : 1.0 - u[axis];
    }
    sum += weight * (2.0 * unit(cell_bits(cell + at, mixed(~shape_index)), 0) - 1.0);
    squares += weight * weight;
  }
  // A value uniform in [-1, 1] has the variance 1/3; the weighted sum has 1/3 of the sum of the
  // squared weights.
  return shape.roughness_m * sum * std::sqrt(3.0 / squares) / std::max(cos_incidence, kLeastCosine);
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
