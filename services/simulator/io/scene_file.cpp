#include "simulator/io/scene_file.hpp"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <functional>
#include <map>
#include <set>
#include <stdexcept>

#include "simulator/path.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

[[noreturn]] void refuse(const YAML::Node& node, const std::string& what) {
  throw std::invalid_argument("line " + std::to_string(node.Mark().line + 1) + ": " + what);
}

void allow_only(const YAML::Node& map, const std::set<std::string>& keys) {
  if (!map.IsMap()) {
    refuse(map, "a map is expected");
  }
  for (const auto& entry : map) {
    if (!entry.first.IsScalar()) {
      refuse(entry.first, "a name is expected as key, not " + YAML::Dump(entry.first));
    }
    const std::string& key = entry.first.Scalar();
    if (!keys.contains(key)) {
      refuse(entry.first, "unknown key '" + key + "'");
    }
  }
}

double number(const YAML::Node& node) {
  double value = 0.0;
  if (!YAML::convert<double>::decode(node, value) || !std::isfinite(value)) {
    refuse(node, "a number is expected");
  }
  return value;
}

void read(const YAML::Node& map, const char* key, double& value) {
  if (map[key]) {
    value = number(map[key]);
  }
}

template <int N>
Eigen::Matrix<double, N, 1> vector(const YAML::Node& node) {
  if (!node.IsSequence() || node.size() != N) {
    refuse(node, std::to_string(N) + " numbers are expected");
  }
  Eigen::Matrix<double, N, 1> out;
  for (int i = 0; i < N; ++i) {
    out[i] = number(node[i]);
  }
  return out;
}

YAML::Node needed(const YAML::Node& map, const char* key) {
  if (!map[key]) {
    refuse(map, std::string("'") + key + "' is missing");
  }
  return map[key];
}

Shape read_shape(const YAML::Node& node) {
  allow_only(node,
             {"kind", "centre", "size", "rpy_deg", "reflectivity", "density_per_m", "roughness_m"});
  Shape shape;
  const auto kind = needed(node, "kind").as<std::string>();
  if (kind == "box") {
    shape.kind = ShapeKind::kBox;
  } else if (kind == "cylinder") {
    shape.kind = ShapeKind::kCylinder;
  } else if (kind == "ellipsoid") {
    shape.kind = ShapeKind::kEllipsoid;
  } else {
    refuse(node["kind"], "'" + kind + "' is none of box, cylinder, ellipsoid");
  }
  shape.centre = vector<3>(needed(node, "centre"));
  shape.half = vector<3>(needed(node, "size")) / 2.0;
  if (!(shape.half.minCoeff() > 0.0)) {
    refuse(node["size"], "sizes must be above 0");
  }
  if (node["rpy_deg"]) {
    shape.R_world_shape =
        pose_from_xyz_rpy_deg(Vector3d::Zero(), vector<3>(node["rpy_deg"])).linear();
  }
  read(node, "reflectivity", shape.reflectivity);
  read(node, "density_per_m", shape.density_per_m);
  read(node, "roughness_m", shape.roughness_m);
  return shape;
}

std::vector<Shape> read_shapes(const YAML::Node& node) {
  std::vector<Shape> shapes;
  for (const YAML::Node& shape : node) {
    shapes.push_back(read_shape(shape));
  }
  return shapes;
}

std::optional<Terrain> read_ground(const YAML::Node& node, std::uint64_t seed) {
  if (!node) {
    return std::nullopt;
  }
  allow_only(node, {"low", "high", "spacing_m", "long_wave_m", "short_wave_m", "relief_m",
                    "reflectivity"});
  TerrainShape shape;
  double spacing_m = 1.0;
  read(node, "spacing_m", spacing_m);
  read(node, "long_wave_m", shape.long_wave_m);
  read(node, "short_wave_m", shape.short_wave_m);
  read(node, "relief_m", shape.relief_m);
  const Vector2d low = vector<2>(needed(node, "low"));
  const Vector2d high = vector<2>(needed(node, "high"));
  if (!(spacing_m > 0.0) || !((high - low).minCoeff() > spacing_m) ||
      (high - low).prod() / (spacing_m * spacing_m) > 1e8) {
    refuse(node, "the ground must extend over more than one cell and no more than 1e8");
  }
  Terrain ground(low, high, spacing_m, shape, seed);
  read(node, "reflectivity", ground.reflectivity);
  return ground;
}

Path read_path(const YAML::Node& node) {
  allow_only(node, {"points", "closed", "corner_radius_m", "smoothing_m"});
  Polyline points;
  for (const YAML::Node& point : needed(node, "points")) {
    points.push_back(vector<2>(point));
    if (points.size() > 1 && (points.back() - points[points.size() - 2]).norm() < 0.1) {
      refuse(point, "points must be at least 0.1 m apart");
    }
  }
  const bool closed = node["closed"] && node["closed"].as<bool>();
  if (points.size() < (closed ? 3U : 2U)) {
    refuse(node, "too few points");
  }
  double radius_m = 5.0;
  double smoothing_m = 2.0;
  read(node, "corner_radius_m", radius_m);
  read(node, "smoothing_m", smoothing_m);
  return smooth_path(points, radius_m, smoothing_m, closed);
}

Mover read_mover(const YAML::Node& node, const std::function<double(double, double)>& ground) {
  allow_only(node, {"points", "speed_m_s", "start_m", "repeat", "shapes"});
  Polyline points;
  for (const YAML::Node& point : needed(node, "points")) {
    points.push_back(vector<2>(point));
  }
  double start_m = 0.0;
  read(node, "start_m", start_m);
  const std::map<std::string, Repeat> ways = {
      {"once", Repeat::kOnce}, {"loop", Repeat::kLoop}, {"to_and_fro", Repeat::kToAndFro}};
  const auto repeat = node["repeat"] ? node["repeat"].as<std::string>() : "once";
  if (!ways.contains(repeat)) {
    refuse(node["repeat"], "'" + repeat + "' is none of once, loop, to_and_fro");
  }
  const double speed_m_s = number(needed(node, "speed_m_s"));
  std::vector<Shape> shapes = read_shapes(needed(node, "shapes"));
  try {
    return {std::move(shapes),
            walk(std::move(points), speed_m_s, start_m, ways.at(repeat), ground)};
  } catch (const std::invalid_argument& error) {
    refuse(node, error.what());
  }
}

Drive read_drive(const YAML::Node& node) {
  Drive drive;
  if (!node) {
    return drive;
  }
  const std::pair<const char*, double*> keys[] = {{"max_speed_m_s", &drive.max_speed_m_s},
                                                  {"max_lateral_m_s2", &drive.max_lateral_m_s2},
                                                  {"acceleration_m_s2", &drive.acceleration_m_s2},
                                                  {"speed_variation", &drive.speed_variation},
                                                  {"still_s", &drive.still_s},
                                                  {"height_m", &drive.height_m},
                                                  {"roll_deg", &drive.roll_deg},
                                                  {"pitch_deg", &drive.pitch_deg},
                                                  {"bob_m", &drive.bob_m},
                                                  {"sway_hz", &drive.sway_hz},
                                                  {"yaw_swing_deg", &drive.yaw_swing_deg},
                                                  {"yaw_swing_hz", &drive.yaw_swing_hz}};
  std::set<std::string> names;
  for (const auto& [key, value] : keys) {
    names.insert(key);
    read(node, key, *value);
  }
  allow_only(node, names);
  if (!(drive.max_speed_m_s > 0.0 && drive.max_lateral_m_s2 > 0.0 &&
        drive.acceleration_m_s2 > 0.0 && drive.speed_variation >= 0.0 &&
        drive.speed_variation < 1.0 && drive.still_s >= 0.5)) {
    refuse(node,
           "speeds and accelerations must be above 0, speed_variation from 0 to below 1, "
           "still_s at least 0.5");
  }
  return drive;
}

Scene scene_from(const YAML::Node& root, const SceneOptions& options) {
  allow_only(root, {"path", "drive", "ground", "shapes", "movers"});
  const std::optional<Terrain> ground = read_ground(root["ground"], options.seed);
  Drive ride = read_drive(root["drive"]);
  ride.max_speed_m_s *= options.speed_factor;
  ride.heading_deg = options.heading_deg;
  ride.laps = options.laps;
  if (ground) {
    ride.ground = [&](double x, double y) { return ground->height(x, y); };
  }
  const Trajectory trajectory = drive(read_path(needed(root, "path")), ride, options.seed);
  std::vector<Mover> movers;
  for (const YAML::Node& mover : root["movers"]) {
    movers.push_back(read_mover(mover, ride.ground));
  }
  return {World(read_shapes(root["shapes"]), ground, std::move(movers)), trajectory};
}

}  // namespace

std::shared_ptr<const Scene> read_scene(const std::string& path, const SceneOptions& options) {
  try {
    return std::make_shared<const Scene>(scene_from(YAML::LoadFile(path), options));
  } catch (const YAML::Exception& error) {
    throw std::invalid_argument(path + ": " + error.what());
  } catch (const std::invalid_argument& error) {
    throw std::invalid_argument(path + ": " + error.what());
  }
}

}  // namespace zloam::simulator
