#pragma once
// The simulator's built-in worlds, each with a motion through it.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "simulator/path.hpp"
#include "simulator/sensor.hpp"
#include "simulator/terrain.hpp"

namespace zloam::simulator {

struct SceneOptions {
  std::uint64_t seed = 1;    ///< for the random placement of objects, and for the motion
  double heading_deg = 0.0;  ///< yaw of the platform against its path, which rotates the walls
                             ///< against the axes of its first pose
  double speed_factor = 1.0;
  int laps = 1;  ///< rounds of a closed path
};

struct SceneInfo {
  std::string name;
  std::string description;
};

/// All names that make_scene knows.
std::vector<SceneInfo> scene_list();

/// Throws std::invalid_argument for an unknown name.
std::shared_ptr<const Scene> make_scene(const std::string& name, const SceneOptions& options);

class SceneBuilder;

/// Sets the solids onto uneven ground and adds the drive over it, with the options applied.
Scene on_ground(SceneBuilder& scene, const Terrain& ground, const Path& path, Drive ride,
                const SceneOptions& options);

/// The individual worlds, as make_scene returns them by name.
Scene city_scene(const SceneOptions& options);
Scene indoor_scene(const SceneOptions& options);
Scene handheld_scene(const SceneOptions& options);
Scene tunnel_scene(const SceneOptions& options, bool with_faces);
Scene flat_scene(const SceneOptions& options);
Scene field_scene(const SceneOptions& options);
Scene park_scene(const SceneOptions& options);
Scene moving_scene(const SceneOptions& options);
Scene town_scene(const SceneOptions& options);
Scene town_later_scene(const SceneOptions& options);

}  // namespace zloam::simulator
