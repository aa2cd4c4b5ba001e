#include "simulator/scenes.hpp"

#include <functional>
#include <stdexcept>

#include "simulator/scene_builder.hpp"

namespace zloam::simulator {
namespace {

struct Entry {
  SceneInfo info;
  std::function<Scene(const SceneOptions&)> make;
};

const std::vector<Entry>& entries() {
  static const std::vector<Entry> all = {
      {{"city", "closed loop of 396 m through streets, up to 7.5 m/s"}, city_scene},
      {{"indoor", "closed loop of 102 m through corridors and furnished rooms, walking"},
       indoor_scene},
      {{"handheld", "furnished hall, sensor in the hand, turning at up to 190 deg/s"},
       handheld_scene},
      {{"tunnel", "90 m of smooth tunnel: nothing tells how far one came"},
       [](const SceneOptions& options) { return tunnel_scene(options, false); }},
      {{"tunnel_weak", "90 m of tunnel with shallow pilasters"},
       [](const SceneOptions& options) { return tunnel_scene(options, true); }},
      {{"flat", "closed loop of 178 m in a yard, motion strictly in the plane"}, flat_scene},
      {{"field", "closed loop of 208 m over an open field with a few posts and bushes"},
       field_scene},
      {{"park",
        "closed loop of 161 m among trees, hedges and boulders: no planes but rough ground"},
       park_scene},
      {{"moving", "the loop of city with traffic: vans ahead and behind, oncoming cars, people"},
       moving_scene},
      {{"town", "closed drive of 3.2 km or more through a grid of streets, many of them twice"},
       town_scene},
      {{"town_later", "town a week later: other cars, a new wall, another drive"},
       town_later_scene},
  };
  return all;
}

}  // namespace

Scene on_ground(SceneBuilder& scene, const Terrain& ground, const Path& path, Drive ride,
                const SceneOptions& options) {
  ride.heading_deg = options.heading_deg;
  ride.laps = options.laps;
  ride.max_speed_m_s *= options.speed_factor;
  scene.lift_onto(ground);
  ride.ground = [&](double x, double y) { return ground.height(x, y); };
  const Trajectory trajectory = drive(path, ride, options.seed);
  return {World(scene.take(), ground), trajectory};
}

std::vector<SceneInfo> scene_list() {
  std::vector<SceneInfo> out;
  for (const Entry& entry : entries()) {
    out.push_back(entry.info);
  }
  return out;
}

std::shared_ptr<const Scene> make_scene(const std::string& name, const SceneOptions& options) {
  for (const Entry& entry : entries()) {
    if (entry.info.name == name) {
      return std::make_shared<const Scene>(entry.make(options));
    }
  }
  throw std::invalid_argument("unknown world '" + name + "'");
}

}  // namespace zloam::simulator
