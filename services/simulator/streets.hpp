#pragma once
// Places the objects along a street, for the worlds with houses.

#include <Eigen/Core>
#include <cmath>

#include "simulator/random.hpp"
#include "simulator/scene_builder.hpp"

namespace zloam::simulator {

/// One side of one street: places are (distance along, distance outward from the path).
struct Front {
  Eigen::Vector2d start;
  Eigen::Vector2d along;
  Eigen::Vector2d outward;
  double length;
  double yaw() const { return std::atan2(along.y(), along.x()); }
  Eigen::Vector2d place(double s, double out) const { return start + s * along + out * outward; }
};

/// A row of houses with occasional gaps, from 12 m before the front to 12 m behind it; `bare` gives
/// plain walls, which constrain the motion less.
void add_houses(SceneBuilder& scene, Random& random, const Front& front, bool bare);
/// A low wall, and objects at a distance behind it: few vertical surfaces near the sensor.
void add_open_side(SceneBuilder& scene, Random& random, const Front& front);
void add_parked_cars(SceneBuilder& scene, Random& random, const Front& front);
/// Trees, posts, bins, signs; fewer if `bare`.
void add_street_furniture(SceneBuilder& scene, Random& random, const Front& front, bool bare);

}  // namespace zloam::simulator
