#include "drive_file.hpp"

#include <yaml-cpp/yaml.h>

#include <map>
#include <numbers>
#include <set>
#include <stdexcept>

namespace zloam::search {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180.0;

// The keys of one YAML map. Keys that were read are known; any other key is refused.
class Keys {
 public:
  Keys(const YAML::Node& map, const char* what) : map_(map), what_(what) {
    if (!map.IsMap()) throw std::invalid_argument(std::string(what) + ": a map is expected");
  }

  template <typename T>
  void read(const char* key, T& value) {
    known_.insert(key);
    if (!map_[key]) return;
    try {
      value = map_[key].as<T>();
    } catch (const YAML::Exception&) {
      throw std::invalid_argument(std::string(what_) + "." + key + " is not of its type");
    }
  }
  void read_deg(const char* key, double& value_rad) {
    double deg = value_rad / kRadPerDeg;
    read(key, deg);
    value_rad = deg * kRadPerDeg;
  }
  YAML::Node part(const char* key) {
    known_.insert(key);
    return map_[key];
  }

  void refuse_unknown() const {
    for (const auto& entry : map_) {
      const auto key = entry.first.as<std::string>();
      if (!known_.contains(key))
        throw std::invalid_argument(std::string(what_) + "." + key + " is unknown");
    }
  }

 private:
  const YAML::Node map_;
  const char* what_;
  std::set<std::string> known_;
};

Wave read_wave(const YAML::Node& node) {
  static const std::map<std::string, Axis> axes = {{"ahead", Axis::kAhead}, {"side", Axis::kSide},
                                                   {"up", Axis::kUp},       {"yaw", Axis::kYaw},
                                                   {"pitch", Axis::kPitch}, {"roll", Axis::kRoll}};
  Keys keys(node, "waves");
  Wave wave;
  std::string axis;
  keys.read("axis", axis);
  if (!axes.contains(axis))
    throw std::invalid_argument("waves.axis is none of ahead, side, up, yaw, pitch, roll");
  wave.axis = axes.at(axis);
  const bool turns = wave.axis >= Axis::kYaw;
  if (turns) {
    keys.read_deg("amplitude_deg", wave.amplitude);
  } else {
    keys.read("amplitude_m", wave.amplitude);
  }
  keys.read("hz", wave.hz);
  keys.read("phase_rad", wave.phase_rad);
  keys.refuse_unknown();
  return wave;
}

Stop read_stop(const YAML::Node& node) {
  Keys keys(node, "stops");
  Stop stop;
  keys.read("at_s", stop.at_s);
  keys.read("stand_s", stop.stand_s);
  keys.read("ramp_s", stop.ramp_s);
  keys.refuse_unknown();
  return stop;
}

Bump read_bump(const YAML::Node& node) {
  Keys keys(node, "bumps");
  Bump bump;
  keys.read("at_s", bump.at_s);
  keys.read("width_s", bump.width_s);
  keys.read("height_m", bump.height_m);
  keys.read_deg("pitch_deg", bump.pitch_rad);
  keys.refuse_unknown();
  return bump;
}

void read_lidar(const YAML::Node& node, BeamConfig& lidar) {
  if (!node) return;
  Keys keys(node, "lidar");
  keys.read("pattern", lidar.pattern);
  keys.read("has_rings", lidar.has_rings);
  keys.read("rings", lidar.rings);
  keys.read("low_deg", lidar.low_deg);
  keys.read("high_deg", lidar.high_deg);
  keys.read("columns", lidar.columns);
  keys.read("hz", lidar.hz);
  keys.read("view_deg", lidar.view_deg);
  keys.read("view_towards_deg", lidar.view_towards_deg);
  keys.read("noise_m", lidar.noise_m);
  keys.read("dropout", lidar.dropout);
  keys.read("min_range_m", lidar.min_range_m);
  keys.read("max_range_m", lidar.max_range_m);
  keys.refuse_unknown();
}

DriveConfig drive_from(const YAML::Node& root) {
  Keys keys(root, "drive");
  DriveConfig drive;
  keys.read("seed", drive.seed);
  keys.read("world", drive.world);
  keys.read("world_seed", drive.scene.seed);
  keys.read("heading_deg", drive.scene.heading_deg);
  keys.read("speed_mps", drive.speed_mps);
  keys.read("lateral_mps2", drive.lateral_mps2);
  keys.read("acceleration_mps2", drive.acceleration_mps2);
  keys.read("height_m", drive.height_m);
  keys.read("start_share", drive.start_share);
  keys.read("start_s", drive.start_s);
  keys.read("duration_s", drive.duration_s);
  keys.read("dropped", drive.dropped);
  for (const YAML::Node& node : keys.part("waves")) drive.waves.push_back(read_wave(node));
  for (const YAML::Node& node : keys.part("stops")) drive.stops.push_back(read_stop(node));
  for (const YAML::Node& node : keys.part("bumps")) drive.bumps.push_back(read_bump(node));
  read_lidar(keys.part("lidar"), drive.lidar);
  keys.refuse_unknown();
  return drive;
}

}  // namespace

DriveConfig read_drive(const std::string& path) {
  try {
    return drive_from(YAML::LoadFile(path));
  } catch (const std::exception& error) {
    throw std::invalid_argument(path + ": " + error.what());
  }
}

}  // namespace zloam::search
