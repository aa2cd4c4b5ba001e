#include "simulator/streets.hpp"

namespace zloam::simulator {
using Eigen::Vector2d;

namespace {

constexpr double kHalfStreetM = 8.5;  // path to the front of the nearest houses
constexpr double kBelowGroundM = -2.0;

BoxSpec placed(const Front& front, double s, double out, double low, double high, double length,
               double depth, double reflectivity) {
  const Vector2d p = front.place(s, out);
  return {p.x(), p.y(), low, high, length, depth, front.yaw(), reflectivity};
}

void add_details(SceneBuilder& scene, Random& random, const Front& front, double s, double face,
                 double length, double height) {
  if (random.chance(0.5) && length > 6.0) {  // bay or porch
    const double depth = random.uniform(0.4, 1.0);
    scene.try_box(placed(front, s + random.uniform(-2.0, 2.0), face - depth / 2.0, kBelowGroundM,
                         random.uniform(2.5, 4.0), random.uniform(1.5, 3.0), depth, 50.0));
  }
  const int balconies = height > 7.0 && random.chance(0.6) ? 2 : 0;
  for (int i = 0; i < balconies; ++i) {
    const double level = 3.0 + 3.0 * i;
    scene.try_box(placed(front, s + random.uniform(-3.0, 3.0), face - 0.6, level, level + 1.0,
                         random.uniform(2.0, 3.5), 1.2, 75.0));
  }
}

void add_tree(SceneBuilder& scene, Random& random, const Vector2d& p) {
  const double trunk = random.uniform(1.8, 2.8);
  if (!scene.try_cylinder(p.x(), p.y(), random.uniform(0.12, 0.3), kBelowGroundM, trunk + 1.0,
                          30.0)) {
    return;
  }
  Shape& crown = scene.ellipsoid({p.x(), p.y(), trunk + 2.0},
                                 {random.uniform(1.2, 2.2), random.uniform(1.2, 2.2), 1.8}, 45.0);
  crown.density_per_m = random.uniform(0.6, 1.6);
}

void add_car(SceneBuilder& scene, Random& random, const Front& front, double s) {
  const double out = 4.4 + random.uniform(-0.25, 0.25);
  const double turn = 0.03 * random.normal();
  const double paint = random.uniform(8.0, 80.0);
  const bool van = random.chance(0.2);
  const Vector2d p = front.place(s, out);
  const BoxSpec body{
      p.x(), p.y(), 0.2, van ? 2.2 : random.uniform(0.8, 1.0), 4.4, 1.8, front.yaw() + turn, paint};
  if (scene.try_box(body) && !van) {
    BoxSpec cabin = body;
    cabin.z_low = body.z_high;
    cabin.z_high = body.z_high + 0.55;
    cabin.length = 2.3;
    cabin.width = 1.55;
    scene.try_box(cabin);
  }
}

}  // namespace

void add_houses(SceneBuilder& scene, Random& random, const Front& front, bool bare) {
  double s = -12.0;
  while (s < front.length + 12.0) {
    const double length = bare ? random.uniform(22.0, 34.0) : random.uniform(8.0, 20.0);
    const double gap = random.chance(0.5) ? 0.0 : random.uniform(2.0, 5.0);
    const double height = random.uniform(4.5, 17.0);
    const double depth = random.uniform(8.0, 12.0);
    const double face = kHalfStreetM + (bare ? 0.0 : random.uniform(0.0, 2.4));
    const double middle = s + length / 2.0;
    const bool house = scene.try_box(placed(front, middle, face + depth / 2.0, kBelowGroundM,
                                            height, length, depth, random.uniform(15.0, 85.0)));
    if (house && !bare) {
      add_details(scene, random, front, middle, face, length, height);
    }
    s += length + gap;
  }
}

void add_open_side(SceneBuilder& scene, Random& random, const Front& front) {
  scene.try_box(placed(front, front.length / 2.0, kHalfStreetM + 1.0, kBelowGroundM, 0.9,
                       front.length - 8.0, 0.3, 40.0));
  for (int i = 0; i < 5; ++i) {
    scene.try_box(placed(front, random.uniform(0.0, front.length), random.uniform(26.0, 45.0),
                         kBelowGroundM, random.uniform(3.0, 9.0), random.uniform(4.0, 12.0),
                         random.uniform(4.0, 9.0), 50.0));
  }
}

void add_parked_cars(SceneBuilder& scene, Random& random, const Front& front) {
  const auto next_car = [&] { return random.uniform(5.5, 16.0); };
  along_line(random.uniform(0.0, 10.0), front.length, next_car, [&](double s) {
    if (random.chance(0.7)) {
      add_car(scene, random, front, s);
    }
  });
}

void add_street_furniture(SceneBuilder& scene, Random& random, const Front& front, bool bare) {
  const double spacing = bare ? 34.0 : 15.0;
  const auto next_post = [&] { return spacing; };
  along_line(random.uniform(0.0, spacing), front.length, next_post, [&](double s) {
    const Vector2d p = front.place(s + random.uniform(-3.0, 3.0), 6.5 + random.uniform(-0.4, 0.4));
    if (random.chance(0.4)) {
      add_tree(scene, random, p);
    } else {
      scene.try_cylinder(p.x(), p.y(), random.chance(0.5) ? 0.08 : 0.15, kBelowGroundM,
                         random.uniform(3.0, 8.0), 70.0);
    }
  });
  for (int i = 0; i < 3; ++i) {  // bins, boxes, signs
    const double size = random.uniform(0.4, 1.0);
    scene.try_box(placed(front, random.uniform(0.0, front.length), random.uniform(5.8, 7.2), -0.5,
                         random.uniform(0.8, 1.4), size, size, random.uniform(20.0, 160.0)));
  }
}

}  // namespace zloam::simulator
