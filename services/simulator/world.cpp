#include "simulator/world.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>

#include "simulator/scene_builder.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr std::int32_t kLeafSize = 2;
constexpr float kPaddingM = 1e-3F;  // covers the rounding of the bounds to float
constexpr int kGreedyDepth = 32;
constexpr std::size_t kStackDepth = 64;

struct Bounds {
  Vector3d low = Vector3d::Constant(std::numeric_limits<double>::infinity());
  Vector3d high = -low;
  void add(const Shape& shape) {
    const Vector3d half = half_bounds(shape);
    low = low.cwiseMin(shape.centre - half);
    high = high.cwiseMax(shape.centre + half);
  }
  double area() const {
    const Vector3d e = high - low;
    return e.x() * e.y() + e.y() * e.z() + e.z() * e.x();
  }
};

struct Split {
  int axis = 0;
  std::int32_t middle = 0;
};

// Tries every split of order[begin, end) and returns the one with the smallest sum of surface times
// count (MacDonald and Booth, "Heuristics for ray tracing using space subdivision", 1990).
Split best_split(const std::vector<Shape>& shapes, std::vector<std::int32_t>& order,
                 std::int32_t begin, std::int32_t end) {
  Split best{0, (begin + end) / 2};
  double best_cost = std::numeric_limits<double>::infinity();
  const auto size = static_cast<std::size_t>(end - begin);
  std::vector<double> cost_above(size);
  for (int axis = 0; axis < 3; ++axis) {
    std::sort(order.begin() + begin, order.begin() + end, [&](std::int32_t a, std::int32_t b) {
      const double ca = shapes[static_cast<std::size_t>(a)].centre[axis];
      const double cb = shapes[static_cast<std::size_t>(b)].centre[axis];
      return ca != cb ? ca < cb : a < b;
    });
    const auto shape_at = [&](std::size_t i) -> const Shape& {
      return shapes[static_cast<std::size_t>(order[static_cast<std::size_t>(begin) + i])];
    };
    Bounds above;
    for (std::size_t i = size - 1; i > 0; --i) {
      above.add(shape_at(i));
      cost_above[i] = above.area() * static_cast<double>(size - i);
    }
    Bounds below;
    for (std::size_t i = 1; i < size; ++i) {
      below.add(shape_at(i - 1));
      const double cost = below.area() * static_cast<double>(i) + cost_above[i];
      if (cost < best_cost) {
        best_cost = cost;
        best = {axis, begin + static_cast<std::int32_t>(i)};
      }
    }
  }
  return best;
}

}  // namespace

World::World(std::vector<Shape> shapes, std::optional<Terrain> terrain, std::vector<Mover> movers)
    : shapes_(std::move(shapes)),
      order_(shapes_.size()),
      terrain_(std::move(terrain)),
      movers_(std::move(movers)) {
  std::iota(order_.begin(), order_.end(), 0);
  nodes_.reserve(2 * shapes_.size() + 1);
  if (!shapes_.empty()) {
    build(0, static_cast<std::int32_t>(shapes_.size()), 0);
  }
  measure_movers();
}

void World::build(std::int32_t begin, std::int32_t end, int depth) {
  Bounds bounds;
  for (std::int32_t i = begin; i < end; ++i) {
    bounds.add(shapes_[static_cast<std::size_t>(order_[static_cast<std::size_t>(i)])]);
  }
  const std::size_t self = nodes_.size();
  nodes_.push_back({bounds.low.cast<float>() - Vector3f::Constant(kPaddingM),
                    bounds.high.cast<float>() + Vector3f::Constant(kPaddingM), begin, end - begin,
                    0});
  if (end - begin <= kLeafSize) {
    return;
  }
  Split split = best_split(shapes_, order_, begin, end);
  if (depth > kGreedyDepth) {
    split.middle = (begin + end) / 2;  // bounds the depth, and with it the stack of a cast
  }
  std::sort(order_.begin() + begin, order_.begin() + end, [&](std::int32_t a, std::int32_t b) {
    const double ca = shapes_[static_cast<std::size_t>(a)].centre[split.axis];
    const double cb = shapes_[static_cast<std::size_t>(b)].centre[split.axis];
    return ca != cb ? ca < cb : a < b;
  });
  build(begin, split.middle, depth + 1);
  nodes_[self].first = static_cast<std::int32_t>(nodes_.size());
  nodes_[self].count = 0;
  nodes_[self].axis = split.axis;
  build(split.middle, end, depth + 1);
}

void World::cast_leaf(const Ray& ray, const Node& node, Hit& best) const {
  for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
    const std::int32_t index = order_[static_cast<std::size_t>(i)];
    const Shape& shape = shapes_[static_cast<std::size_t>(index)];
    const auto crossing = cross(ray, shape, static_cast<std::uint64_t>(index), best.range_m);
    if (crossing && crossing->range_m < best.range_m) {
      best = {crossing->range_m, crossing->cos_incidence, shape.reflectivity, index};
    }
  }
}

void World::cast_shapes(const Ray& ray, Hit& best) const {
  const Vector3f origin = ray.origin.cast<float>();
  // A component of 0 would give 0 * infinity = NaN in the slab test below.
  const Vector3f inverse = ray.direction.cast<float>().unaryExpr(
      [](float v) { return 1.0F / (std::abs(v) < 1e-12F ? 1e-12F : v); });
  std::array<std::int32_t, kStackDepth> stack;
  std::size_t depth = 0;
  stack[depth++] = 0;
  while (depth > 0) {
    const std::int32_t index = stack[--depth];
    const Node& node = nodes_[static_cast<std::size_t>(index)];
    const Vector3f to_low = (node.low - origin).cwiseProduct(inverse);
    const Vector3f to_high = (node.high - origin).cwiseProduct(inverse);
    const float enter = to_low.cwiseMin(to_high).maxCoeff();
    const float leave = to_low.cwiseMax(to_high).minCoeff();
    if (enter > leave || leave < 0.0F || enter > static_cast<float>(best.range_m)) {
      continue;
    }
    if (node.count > 0) {
      cast_leaf(ray, node, best);
    } else {
      // The nearer child is visited first, so that the other one can often be skipped.
      const bool forward = ray.direction[node.axis] >= 0.0;
      stack[depth++] = forward ? node.first : index + 1;
      stack[depth++] = forward ? index + 1 : node.first;
    }
  }
}

void World::measure_movers() {
  int surface = static_cast<int>(shapes_.size());
  for (const Mover& mover : movers_) {
    double radius = 0.0;
    for (const Shape& shape : mover.shapes) {
      radius = std::max(radius, shape.centre.norm() + shape.half.norm());
    }
    first_surface_.push_back(surface);
    radii_.push_back(radius);
    surface += static_cast<int>(mover.shapes.size());
  }
}

void World::add_moving(std::size_t mover, double time_s, std::vector<MovingShape>& out) const {
  const Track::State state = movers_[mover].track.at(time_s);
  const Eigen::Matrix3d R = turned(state.yaw_rad);
  int surface = first_surface_[mover];
  for (const Shape& own : movers_[mover].shapes) {
    MovingShape moving{own, state.velocity, surface++};
    moving.shape.centre = state.place + R * own.centre;
    moving.shape.R_world_shape = R * own.R_world_shape;
    out.push_back(std::move(moving));
  }
}

std::vector<MovingShape> World::moving_at(double time_s) const {
  std::vector<MovingShape> out;
  for (std::size_t mover = 0; mover < movers_.size(); ++mover) {
    add_moving(mover, time_s, out);
  }
  return out;
}

Hit World::cast(const Ray& ray, double max_range_m, std::span<const MovingShape> moving,
                double after_s) const {
  Hit best;
  best.range_m = max_range_m;
  if (!shapes_.empty()) {
    cast_shapes(ray, best);
  }
  if (terrain_) {
    if (const auto crossing = terrain_->cross(ray, best.range_m)) {
      best = {crossing->range_m, crossing->cos_incidence, terrain_->reflectivity, kGround};
    }
  }
  const MovingShape* moved = nullptr;
  for (const MovingShape& candidate : moving) {
    // For a shape with constant velocity, moving the ray's origin back is the same as moving the
    // shape on.
    const Ray relative{ray.origin - after_s * candidate.velocity, ray.direction};
    const auto crossing = cross(relative, candidate.shape,
                                static_cast<std::uint64_t>(candidate.surface), best.range_m);
    if (crossing && crossing->range_m < best.range_m) {
      best = {crossing->range_m, crossing->cos_incidence, candidate.shape.reflectivity,
              candidate.surface};
      moved = &candidate;
    }
  }
  if (best.surface >= 0) {
    const Shape& shape =
        moved != nullptr ? moved->shape : shapes_[static_cast<std::size_t>(best.surface)];
    const Vector3d shift =
        moved != nullptr ? Vector3d(after_s * moved->velocity) : Vector3d::Zero();
    best.range_m += relief_along(ray.origin - shift + best.range_m * ray.direction, shape,
                                 static_cast<std::uint64_t>(best.surface), best.cos_incidence);
  }
  return best;
}

}  // namespace zloam::simulator
