#pragma once
// A drive of the search: a world, how the platform goes through it, and the lidar it carries.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "beams.hpp"
#include "simulator/scenes.hpp"

namespace zloam::search {

/// What the platform can be shaken along. Lengths are m in its own upright frame, turns rad.
enum class Axis : std::uint8_t { kAhead, kSide, kUp, kYaw, kPitch, kRoll };

struct Wave {
  Axis axis = Axis::kUp;
  double amplitude = 0.0;
  double hz = 1.0;
  double phase_rad = 0.0;
};

/// Brakes, stands and sets off again; ramp_s each way.
struct Stop {
  double at_s = 0.0;
  double stand_s = 0.0;
  double ramp_s = 1.0;
};

/// Something driven over: up and down again, nose first.
struct Bump {
  double at_s = 0.0;
  double width_s = 0.3;
  double height_m = 0.0;
  double pitch_rad = 0.0;
};

struct DriveConfig {
  std::uint64_t seed = 1;  ///< of noise and of the speed's wandering
  std::string world = "city";
  simulator::SceneOptions scene;
  double speed_mps = 0.0;  ///< greatest; 0: the world's own drive
  double lateral_mps2 = 1.3;
  double acceleration_mps2 = 1.5;
  double height_m = 1.5;
  double start_share = 0.0;  ///< of the path, where the drive begins
  double start_s = 0.0;      ///< of the motion, when the first sweep begins; it stands for 1 s
  double duration_s = 20.0;
  std::vector<Wave> waves;
  std::vector<Stop> stops;
  std::vector<Bump> bumps;
  BeamConfig lidar;
  std::vector<std::uint32_t> dropped;  ///< sweeps that do not arrive, ascending
};

/// The largest of each over a drive.
struct Extremes {
  double speed_mps = 0.0;
  double acceleration_mps2 = 0.0;
  double rate_radps = 0.0;
  double angular_acceleration_radps2 = 0.0;
  double nearest_m = 1e9;  ///< surface around the lidar, of 26 directions every 0.1 s
};

/// What a platform, a person or a vehicle can do to a lidar that survives it.
struct Limits {
  double speed_mps = 31.0;
  double acceleration_mps2 = 40.0;
  double rate_radps = 10.5;
  double angular_acceleration_radps2 = 150.0;
  double nearest_m = 0.1;
};

/// A world and the motion of its drive. Throws std::invalid_argument for an unknown world.
simulator::Scene scene_of(const DriveConfig& config);

/// From start_s to the end of the last sweep.
Extremes extremes(const simulator::Scene& scene, const DriveConfig& config);

/// Throws std::invalid_argument that says what is beyond the limits.
void require_possible(const Extremes& found, const Limits& limits);

/// Sweeps that begin and end within the drive, dropped ones included.
std::uint32_t sweep_count(const simulator::Scene& scene, const DriveConfig& config);

}  // namespace zloam::search
