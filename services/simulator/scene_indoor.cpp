// Worlds inside a building: indoor, a loop of corridors and furnished rooms; handheld, a hall in
// which the sensor is carried by hand.

#include <cmath>
#include <numbers>

#include "simulator/random.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

void add_table(SceneBuilder& scene, Random& random, double x, double y) {
  const double yaw = random.uniform(-0.1, 0.1) + (random.chance(0.3) ? 0.8 : 0.0);
  const double length = random.uniform(1.2, 2.0);
  const double width = random.uniform(0.6, 0.9);
  const BoxSpec top{x, y, 0.70, 0.74, length, width, yaw, 65.0};
  if (!scene.try_box(top)) {
    return;
  }
  for (const double u : {-0.45, 0.45}) {
    for (const double v : {-0.42, 0.42}) {
      const Eigen::Vector3d leg = turned(yaw) * Eigen::Vector3d(u * length, v * width, 0.0);
      scene.box({x + leg.x(), y + leg.y(), -0.1, 0.70, 0.06, 0.06, yaw, 30.0});
    }
  }
  const Eigen::Vector3d chair = turned(yaw) * Eigen::Vector3d(0.2, 0.5 * width + 0.35, 0.0);
  scene.try_box({x + chair.x(), y + chair.y(), 0.40, 0.46, 0.45, 0.45, yaw, 25.0});
  scene.try_box({x + 1.3 * chair.x(), y + 1.3 * chair.y(), -0.1, 0.9, 0.42, 0.05, yaw, 25.0});
}

void furnish(SceneBuilder& scene, Random& random, const Rectangle& room, double ceiling,
             int count) {
  for (int i = 0; i < count; ++i) {
    const double x = random.uniform(room.x_low + 0.5, room.x_high - 0.5);
    const double y = random.uniform(room.y_low + 0.5, room.y_high - 0.5);
    const double kind = random.uniform();
    if (kind < 0.4) {
      add_table(scene, random, x, y);
    } else if (kind < 0.75) {  // cupboard along the nearest long wall
      const bool low_side = y - room.y_low < room.y_high - y;
      const double depth = random.uniform(0.3, 0.6);
      scene.try_box({x, low_side ? room.y_low + depth / 2.0 : room.y_high - depth / 2.0, -0.1,
                     random.uniform(0.8, 2.2), random.uniform(0.6, 1.8), depth, 0.0,
                     random.uniform(20.0, 80.0)});
    } else if (kind < 0.9) {
      const double size = random.uniform(0.3, 0.7);
      scene.try_box({x, y, -0.1, random.uniform(0.3, 1.6), size, size,
                     random.uniform(0.0, std::numbers::pi), random.uniform(15.0, 70.0)});
    } else {
      scene.try_cylinder(x, y, random.uniform(0.1, 0.25), -0.1, ceiling, 60.0);
    }
  }
}

// Places frames, radiators and cupboards in a corridor; `bare` leaves long smooth walls.
void line_corridor(SceneBuilder& scene, Random& random, const Rectangle& c, double ceiling,
                   bool bare) {
  const bool along_x = c.x_high - c.x_low > c.y_high - c.y_low;
  const double low = along_x ? c.x_low : c.y_low;
  const double high = along_x ? c.x_high : c.y_high;
  const auto next = [&] { return bare ? random.uniform(6.0, 9.0) : random.uniform(2.0, 4.5); };
  along_line(low + 1.0, high - 1.0, next, [&](double s) {
    const double depth = random.uniform(0.06, 0.3);
    const double length = random.uniform(0.15, 1.2);
    const bool low_side = random.chance(0.5);
    const double top = random.chance(0.4) ? ceiling : random.uniform(0.7, 2.1);
    const double refl = random.uniform(20.0, 80.0);
    if (along_x) {
      const double y = low_side ? c.y_low + depth / 2.0 : c.y_high - depth / 2.0;
      scene.try_box({s, y, -0.1, top, length, depth, 0.0, refl});
    } else {
      const double x = low_side ? c.x_low + depth / 2.0 : c.x_high - depth / 2.0;
      scene.try_box({x, s, -0.1, top, depth, length, 0.0, refl});
    }
  });
}

void add_ceilings(SceneBuilder& scene, const std::vector<Rectangle>& free, double height) {
  for (const Rectangle& r : free) {
    scene.box({(r.x_low + r.x_high) / 2.0, (r.y_low + r.y_high) / 2.0, height, height + 0.3,
               r.x_high - r.x_low + 0.1, r.y_high - r.y_low + 0.1, 0.0, 80.0});
  }
}

}  // namespace

Scene indoor_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  constexpr double kCeilingM = 2.9;
  const Path path = smooth_path(
      {{2.0, -9.0}, {17.0, -9.0}, {17.0, 9.5}, {7.5, 9.5}, {3.0, 8.2}, {-16.5, 8.2}, {-16.5, -9.0}},
      0.9, 1.0, true);
  const Rectangle room_south{-7.0, -13.0, 6.5, -5.8};
  const Rectangle room_north{-4.5, 5.0, 8.5, 12.5};
  const Rectangle corridors[] = {{6.8, -10.1, 18.2, -7.9},   {15.8, -10.1, 18.2, 10.6},
                                 {8.8, 8.4, 18.2, 10.6},     {-17.7, 7.1, -4.8, 9.3},
                                 {-17.7, -10.1, -15.3, 9.3}, {-17.7, -10.1, -7.3, -7.9}};
  const Rectangle doors[] = {{6.4, -9.6, 6.9, -8.4},
                             {8.4, 8.9, 8.9, 10.1},
                             {-4.9, 7.6, -4.4, 8.8},
                             {-7.4, -9.6, -6.9, -8.4}};
  // A side room with an open door, which is seen only in passing.
  const Rectangle side_room{9.5, -2.0, 15.5, 4.0};
  const Rectangle side_door{15.4, 0.5, 15.9, 1.5};
  std::vector<Rectangle> free(std::begin(corridors), std::end(corridors));
  free.insert(free.end(), std::begin(doors), std::end(doors));
  free.insert(free.end(), {room_south, room_north, side_room, side_door});
  SceneBuilder scene;
  scene.keep_clear(path, 0.45);
  scene.walls_around(free, kCeilingM, 0.1, 70.0);
  add_ceilings(scene, free, kCeilingM);
  furnish(scene, random, room_south, kCeilingM, 26);
  furnish(scene, random, room_north, kCeilingM, 26);
  furnish(scene, random, side_room, kCeilingM, 8);
  for (std::size_t i = 0; i < std::size(corridors); ++i) {
    line_corridor(scene, random, corridors[i], kCeilingM, i == 1);
  }
  const Terrain floor({-30, -30}, {30, 30}, 1.0, {0.0, 0.0, 0.003}, options.seed);
  Drive walk;
  walk.max_speed_m_s = 1.5 * options.speed_factor;
  walk.max_lateral_m_s2 = 0.7;
  walk.acceleration_m_s2 = 0.8;
  walk.height_m = 1.05;
  walk.roll_deg = walk.pitch_deg = 1.0;
  walk.bob_m = 0.02;
  walk.sway_hz = 1.2;
  walk.heading_deg = options.heading_deg;
  walk.laps = options.laps;
  return {World(scene.take(), floor), drive(path, walk, options.seed)};
}

Scene handheld_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  constexpr double kCeilingM = 3.6;
  const Path path = smooth_path({{0.0, -2.4}, {4.0, -2.4}, {4.0, 2.4}, {-4.0, 2.4}, {-4.0, -2.4}},
                                1.3, 1.0, true);
  const std::vector<Rectangle> free = {{-9.0, -6.8, 9.0, 6.8}, {9.0, -1.0, 16.0, 1.5}};
  SceneBuilder scene;
  scene.keep_clear(path, 0.5);
  scene.walls_around(free, kCeilingM, 0.3, 65.0);
  add_ceilings(scene, free, kCeilingM);
  furnish(scene, random, free.front(), kCeilingM, 34);
  const Terrain floor({-20, -20}, {20, 20}, 1.0, {0.0, 0.0, 0.003}, options.seed);
  Drive walk;
  walk.max_speed_m_s = 0.9 * options.speed_factor;
  walk.max_lateral_m_s2 = 0.6;
  walk.acceleration_m_s2 = 0.8;
  walk.height_m = 1.25;
  walk.roll_deg = walk.pitch_deg = 4.5;
  walk.bob_m = 0.035;
  walk.sway_hz = 0.8;
  walk.yaw_swing_deg = 55.0;
  walk.yaw_swing_hz = 0.45;
  walk.heading_deg = options.heading_deg;
  walk.laps = options.laps;
  return {World(scene.take(), floor), drive(path, walk, options.seed)};
}

}  // namespace zloam::simulator
