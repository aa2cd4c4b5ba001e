#pragma once
// A drive of the search: a world, the platform's motion through it, and the lidar on the platform.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "beams.hpp"
#include "simulator/scenes.hpp"

namespace zloam::search {

/// The axes along or about which the platform can be shaken, in its own upright frame: m or rad.
enum class Axis : std::uint8_t { kAhead, kSide, kUp, kYaw, kPitch, kRoll };

struct Wave {
  Axis axis = Axis::kUp;
  double amplitude = 0.0;
  double hz = 1.0;
  double phase_rad = 0.0;
};

/// The platform brakes within ramp_s, stands, and accelerates again within ramp_s.
struct Stop {
  double at_s = 0.0;
  double stand_s = 0.0;
  double ramp_s = 1.0;
};

/// A bump in the ground: the platform goes up and down again, and pitches up and then down.
struct Bump {
  double at_s = 0.0;
  double width_s = 0.3;
  double height_m = 0.0;
  double pitch_rad = 0.0;
};

struct DriveConfig {
  std::uint64_t seed = 1;  ///< for the noise and the speed's variation
  std::string world = "city";
  simulator::SceneOptions scene;
  double speed_mps = 0.0;  ///< maximum; 0: use the world's own drive
  double lateral_mps2 = 1.3;
  double acceleration_mps2 = 1.5;
  double height_m = 1.5;
  double start_share = 0.0;  ///< where on the path the drive begins, as a share of its length
  double start_s = 0.0;      ///< start of the first sweep; the platform rests for the first 1 s
  double duration_s = 20.0;
  std::vector<Wave> waves;
  std::vector<Stop> stops;
  std::vector<Bump> bumps;
  BeamConfig lidar;
  std::vector<std::uint32_t> dropped;  ///< numbers of sweeps that do not arrive, ascending
};

/// The extreme values over a drive.
struct Extremes {
  double speed_mps = 0.0;
  double acceleration_mps2 = 0.0;
  double rate_radps = 0.0;
  double angular_acceleration_radps2 = 0.0;
  double nearest_m = 1e9;  ///< nearest surface, in 26 directions around the lidar every 0.1 s
};

/// The most violent motion that a platform, person or vehicle can impose on a lidar without
/// destroying it.
struct Limits {
  double speed_mps = 31.0;
  double acceleration_mps2 = 40.0;
  double rate_radps = 10.5;
  double angular_acceleration_radps2 = 150.0;
  double nearest_m = 0.1;
};

/// A world and the motion of its drive. Throws std::invalid_argument for an unknown world.
simulator::Scene scene_of(const DriveConfig& config);

/// The extremes from start_s to the end of the last sweep.
Extremes extremes(const simulator::Scene& scene, const DriveConfig& config);

/// Throws std::invalid_argument, naming the value that is beyond its limit.
void require_possible(const Extremes& found, const Limits& limits);

/// Number of sweeps that begin and end within the drive, including dropped ones.
std::uint32_t sweep_count(const simulator::Scene& scene, const DriveConfig& config);

}  // namespace zloam::search
