// A closed loop through streets: houses of all depths with bays, balconies and gaps between them,
// parked cars, poles and trees; one stretch with bare walls, one almost open. The ground rolls.

#include <cmath>
#include <numbers>

#include "simulator/random.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;

constexpr double kHalfStreetM = 8.5;  // path to the front of the nearest houses
constexpr double kBelowGroundM = -2.0;

// One side of one street: places are (distance along, distance outward from the path).
struct Front {
  Vector2d start;
  Vector2d along;
  Vector2d outward;
  double length;
  double yaw() const { return std::atan2(along.y(), along.x()); }
  Vector2d place(double s, double out) const { return start + s * along + out * outward; }
};

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

// Houses wall to wall with now and then a gap; bare fronts if the stretch is to be hard.
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

// A low wall and what stands behind it at a distance: few vertical surfaces near the sensor.
void add_open_side(SceneBuilder& scene, Random& random, const Front& front) {
  scene.try_box(placed(front, front.length / 2.0, kHalfStreetM + 1.0, kBelowGroundM, 0.9,
                       front.length - 8.0, 0.3, 40.0));
  for (int i = 0; i < 5; ++i) {
    scene.try_box(placed(front, random.uniform(0.0, front.length), random.uniform(26.0, 45.0),
                         kBelowGroundM, random.uniform(3.0, 9.0), random.uniform(4.0, 12.0),
                         random.uniform(4.0, 9.0), 50.0));
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

void add_street_furniture(SceneBuilder& scene, Random& random, const Front& front, bool bare) {
  const auto next_car = [&] { return random.uniform(5.5, 16.0); };
  along_line(random.uniform(0.0, 10.0), front.length, next_car, [&](double s) {
    if (random.chance(0.7)) {
      add_car(scene, random, front, s);
    }
  });
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

}  // namespace

Scene city_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  // Start in the middle of the first street; one corner is cut, so that walls stand at 45 degrees.
  const Polyline corners = {{67, -40}, {67, 9}, {38, 40}, {-66, 40}, {-66, -40}};
  Polyline way{{0.0, -40.0}};
  way.insert(way.end(), corners.begin(), corners.end());
  const Path path = smooth_path(way, 9.0, 3.0, true);
  const Terrain ground({-160, -140}, {160, 140}, 1.0, {0.5, 0.03, 0.008}, options.seed);
  SceneBuilder scene;
  scene.keep_clear(path, 2.2);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vector2d& a = corners[(i + corners.size() - 1) % corners.size()];
    const Vector2d along = (corners[i] - a).normalized();
    const Vector2d left(-along.y(), along.x());
    const double length = (corners[i] - a).norm();
    for (const double side : {1.0, -1.0}) {
      const Front front{a, along, side * left, length};
      const bool bare = i == 3;
      if (i == 1 && side < 0.0) {
        add_open_side(scene, random, front);
      } else {
        add_houses(scene, random, front, bare);
      }
      add_street_furniture(scene, random, front, bare);
    }
  }
  Drive ride;
  ride.heading_deg = options.heading_deg;
  ride.laps = options.laps;
  ride.max_speed_m_s *= options.speed_factor;
  scene.lift_onto(ground);
  ride.ground = [&](double x, double y) { return ground.height(x, y); };
  const Trajectory trajectory = drive(path, ride, options.seed);
  return {World(scene.take(), ground), trajectory};
}

}  // namespace zloam::simulator
