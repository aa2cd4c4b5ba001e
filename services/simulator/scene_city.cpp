// World city: a closed loop through streets with houses of all depths, bays, balconies and gaps,
// parked cars, poles and trees; one stretch has bare walls, one is almost open. The ground is
// rolling.

#include "simulator/scenes.hpp"
#include "simulator/streets.hpp"

namespace zloam::simulator {

Scene city_scene(const SceneOptions& options) {
  Random random(options.seed, Stream::kWorld);
  // The drive starts in the middle of the first street. One corner is cut, for walls at 45 degrees.
  const Polyline corners = {{67, -40}, {67, 9}, {38, 40}, {-66, 40}, {-66, -40}};
  Polyline way{{0.0, -40.0}};
  way.insert(way.end(), corners.begin(), corners.end());
  const Path path = smooth_path(way, 9.0, 3.0, true);
  const Terrain ground({-160, -140}, {160, 140}, 1.0, {0.5, 0.03, 0.008}, options.seed);
  SceneBuilder scene;
  scene.keep_clear(path, 2.2);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector2d& a = corners[(i + corners.size() - 1) % corners.size()];
    const Eigen::Vector2d along = (corners[i] - a).normalized();
    const Eigen::Vector2d left(-along.y(), along.x());
    const double length = (corners[i] - a).norm();
    for (const double side : {1.0, -1.0}) {
      const Front front{a, along, side * left, length};
      const bool bare = i == 3;
      if (i == 1 && side < 0.0) {
        add_open_side(scene, random, front);
      } else {
        add_houses(scene, random, front, bare);
      }
      add_parked_cars(scene, random, front);
      add_street_furniture(scene, random, front, bare);
    }
  }
  return on_ground(scene, ground, path, Drive(), options);
}

}  // namespace zloam::simulator
