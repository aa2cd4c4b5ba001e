// Worlds with few constraints (tunnels, a flat yard, an open field), and a park of curved, rough
// and leafy objects without planes.

#include <cmath>
#include <numbers>

#include "simulator/random.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

constexpr double kTunnelHalfWidthM = 2.1;
constexpr double kTunnelHeightM = 3.2;

Polyline oval(double half_length, double half_width) {
  return {{0.0, -half_width},
          {half_length, -half_width},
          {half_length, half_width},
          {-half_length, half_width},
          {-half_length, -half_width}};
}

}  // namespace

Scene tunnel_scene(const SceneOptions& options, bool with_faces) {
  Random random(options.seed, Stream::kWorld);
  constexpr double kLengthM = 90.0;
  constexpr double kMarginM = 130.0;  // beyond the sensor's range, so that it never sees an end
  SceneBuilder scene;
  const Path path =
      smooth_path({{0.0, 0.0}, {kLengthM / 2.0, 0.0}, {kLengthM, 0.0}}, 1.0, 1.0, false);
  scene.keep_clear(path, 0.8);
  const double whole = kLengthM + 2.0 * kMarginM;
  for (const double side : {-1.0, 1.0}) {
    scene.box({kLengthM / 2.0, side * (kTunnelHalfWidthM + 0.25), -0.3, kTunnelHeightM + 0.3, whole,
               0.5, 0.0, 60.0});
  }
  scene.box({kLengthM / 2.0, 0.0, -0.3, 0.0, whole, 5.0, 0.0, 30.0});
  scene.box({kLengthM / 2.0, 0.0, kTunnelHeightM, kTunnelHeightM + 0.3, whole, 5.0, 0.0, 60.0});
  if (with_faces) {  // shallow pilasters: small surfaces that face along the axis
    const auto next = [&] { return random.uniform(5.0, 11.0); };
    along_line(-kMarginM + 20.0, kLengthM + kMarginM - 20.0, next, [&](double x) {
      const double depth = random.uniform(0.08, 0.25);
      scene.try_box({x, random.sign() * (kTunnelHalfWidthM - depth / 2.0), -0.1,
                     random.chance(0.6) ? kTunnelHeightM : 1.8, random.uniform(0.2, 0.6), depth,
                     0.0, 50.0});
    });
  }
  Drive ride;
  ride.max_speed_m_s = 4.0 * options.speed_factor;
  ride.height_m = 1.2;
  ride.roll_deg = ride.pitch_deg = 0.4;
  ride.bob_m = 0.01;
  ride.heading_deg = options.heading_deg;
  ride.laps = options.laps;
  return {World(scene.take(), std::nullopt), drive(path, ride, options.seed)};
}

Scene flat_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  const Path path = smooth_path(oval(30.0, 18.0), 8.0, 3.0, true);
  SceneBuilder scene;
  scene.keep_clear(path, 2.0);
  for (int i = 0; i < 9; ++i) {  // containers and sheds in a yard
    scene.try_box({random.uniform(-55.0, 55.0), random.uniform(-42.0, 42.0), -0.1,
                   random.uniform(2.4, 5.2), random.uniform(4.0, 12.0), 2.5,
                   random.uniform(0.0, std::numbers::pi), random.uniform(20.0, 70.0)});
  }
  for (int i = 0; i < 12; ++i) {
    scene.try_cylinder(random.uniform(-45.0, 45.0), random.uniform(-35.0, 35.0), 0.12, -0.1,
                       random.uniform(3.0, 7.0), 70.0);
  }
  const Terrain ground({-160, -150}, {160, 150}, 5.0, {}, options.seed);
  Drive ride;
  ride.max_speed_m_s = 5.0 * options.speed_factor;
  ride.height_m = 1.6;
  ride.roll_deg = ride.pitch_deg = ride.bob_m = 0.0;
  ride.heading_deg = options.heading_deg;
  ride.laps = options.laps;
  return {World(scene.take(), ground), drive(path, ride, options.seed)};
}

Scene field_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  const Path path = smooth_path(oval(35.0, 22.0), 12.0, 3.0, true);
  SceneBuilder scene;
  scene.keep_clear(path, 3.0);
  for (int i = 0; i < 14; ++i) {  // lone posts and bushes far from each other
    const double angle = random.uniform(0.0, 2.0 * std::numbers::pi);
    const double radius = random.uniform(10.0, 75.0);
    const double x = radius * std::cos(angle);
    const double y = radius * std::sin(angle);
    if (random.chance(0.5)) {
      scene.try_cylinder(x, y, 0.1, -2.0, random.uniform(1.5, 4.0), 50.0);
    } else if (scene.is_clear({x, y, 0.0, 1.0, 2.0, 2.0, 0.0, 0.0})) {
      scene.ellipsoid({x, y, 0.7}, {0.9, 0.8, 0.8}, 40.0).density_per_m = 2.0;
    }
  }
  const Terrain ground({-170, -160}, {170, 160}, 1.0, {0.6, 0.05, 0.02}, options.seed);
  Drive ride;
  ride.max_speed_m_s = 4.0;
  ride.height_m = 1.6;
  ride.roll_deg = ride.pitch_deg = 1.0;
  return on_ground(scene, ground, path, ride, options);
}

Scene park_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  const Path path = smooth_path(oval(28.0, 16.0), 9.0, 3.0, true);
  SceneBuilder scene;
  scene.keep_clear(path, 1.3);
  for (int i = 0; i < 110; ++i) {
    const double x = random.uniform(-50.0, 50.0);
    const double y = random.uniform(-38.0, 38.0);
    if (!scene.is_clear({x, y, 0.0, 1.0, 2.0, 2.0, 0.0, 0.0})) {
      continue;
    }
    const double kind = random.uniform();
    if (kind < 0.5) {  // tree
      scene.cylinder(x, y, random.uniform(0.1, 0.4), -2.0, 4.0, 30.0).roughness_m = 0.015;
      const double half = random.uniform(1.2, 2.6);
      scene.ellipsoid({x, y, 2.5 + half}, {half, half, half}, 45.0).density_per_m =
          random.uniform(0.5, 1.5);
    } else if (kind < 0.8) {  // hedge
      Shape& hedge = scene.box({x, y, -1.0, random.uniform(0.8, 1.8), random.uniform(2.0, 6.0), 0.8,
                                random.uniform(0.0, std::numbers::pi), 40.0});
      hedge.density_per_m = random.uniform(2.0, 5.0);
    } else {  // boulder
      const double size = random.uniform(0.4, 1.4);
      Shape& boulder = scene.ellipsoid(
          {x, y, 0.2}, {size, random.uniform(0.6, 1.0) * size, random.uniform(0.5, 0.9) * size},
          35.0);
      boulder.R_world_shape = turned(random.uniform(0.0, std::numbers::pi));
      boulder.roughness_m = 0.02;
    }
  }
  for (const double side : {-1.0, 1.0}) {  // a round pavilion and a curved wall
    scene.cylinder(side * 60.0, side * 10.0, 9.0, -2.0, 6.0, 60.0);
  }
  const Terrain ground({-160, -150}, {160, 150}, 1.0, {0.8, 0.06, 0.03}, options.seed);
  Drive ride;
  ride.max_speed_m_s = 2.5;
  ride.height_m = 1.4;
  ride.roll_deg = ride.pitch_deg = 1.2;
  ride.sway_hz = 1.1;
  return on_ground(scene, ground, path, ride, options);
}

}  // namespace zloam::simulator
