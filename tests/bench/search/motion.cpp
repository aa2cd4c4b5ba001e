#include "motion.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <stdexcept>

namespace zloam::search {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using simulator::Knot;
using simulator::MotionState;
using simulator::Path;
using simulator::Scene;
using simulator::Trajectory;
using std::numbers::pi;

constexpr double kStillS = 1.0;   // time at rest at the start of a drive
constexpr double kEngageS = 1.0;  // time until the shaking has its full amplitude
constexpr double kKnotStepS = 0.01;
constexpr double kPathSpacingM = 0.01;

// Rises from 0 to 1 with two continuous derivatives.
double step(double u) {
  const double c = std::clamp(u, 0.0, 1.0);
  return c * c * c * (10.0 + c * (6.0 * c - 15.0));
}

// Points at equal spacing along the way; rest_m gets the length that remains at its end.
Path spaced(const Trajectory& trajectory, double spacing_m, double& rest_m) {
  constexpr double kSampleS = 0.0005;
  Path path{spacing_m, {trajectory.at(0.0).T_world_body.translation().head<2>()}};
  Vector2d before = path.points.front();
  double to_next = spacing_m;
  for (double t = kSampleS; t < trajectory.duration_s(); t += kSampleS) {
    const Vector2d here = trajectory.at(t).T_world_body.translation().head<2>();
    double rest = (here - before).norm();
    while (rest >= to_next) {
      before += to_next / rest * (here - before);
      rest = (here - before).norm();
      path.points.push_back(before);
      to_next = spacing_m;
    }
    to_next -= rest;
    before = here;
  }
  rest_m = spacing_m - to_next;
  return path;
}

// The path of the world's own drive, without its times. The spacing divides the length, because
// otherwise a second lap would begin with a jerk.
Path way_of(const Trajectory& trajectory) {
  double rest_m = 0.0;
  const Path rough = spaced(trajectory, kPathSpacingM, rest_m);
  const double length_m = rough.length_m() + rest_m;
  const double exact_m = length_m / std::round(length_m / kPathSpacingM);
  // slightly less, so that rounding does not lose the last point
  return spaced(trajectory, exact_m * (1.0 - 1e-9), rest_m);
}

bool closed(const Path& path) {
  return (path.points.back() - path.points.front()).norm() < 2.0 * path.spacing_m;
}

// The same path with another start. An open path loses the part before it.
Path begun_at(Path path, double share) {
  const auto first = static_cast<std::ptrdiff_t>(share * static_cast<double>(path.points.size()));
  if (closed(path)) {
    path.points.pop_back();
    std::rotate(path.points.begin(), path.points.begin() + first, path.points.end());
    path.points.push_back(path.points.front());
  } else {
    path.points.erase(path.points.begin(), path.points.begin() + first);
  }
  return path;
}

Trajectory driven(const Scene& scene, const DriveConfig& config) {
  if (config.speed_mps <= 0.0) return scene.trajectory;
  const Path path = begun_at(way_of(scene.trajectory), config.start_share);
  simulator::Drive ride;
  ride.max_speed_m_s = config.speed_mps;
  ride.max_lateral_m_s2 = config.lateral_mps2;
  ride.acceleration_m_s2 = config.acceleration_mps2;
  ride.still_s = kStillS;
  ride.height_m = config.height_m;
  ride.roll_deg = ride.pitch_deg = ride.bob_m = 0.0;
  ride.heading_deg = config.scene.heading_deg;
  const double wanted_m = config.speed_mps * (config.start_s + config.duration_s);
  if (closed(path)) ride.laps = 1 + static_cast<int>(wanted_m / path.length_m());
  const auto& ground = scene.world.terrain();
  if (ground) ride.ground = [&ground](double x, double y) { return ground->height(x, y); };
  return drive(path, ride, config.seed);
}

double wave_sum(const DriveConfig& config, Axis axis, double time_s) {
  double sum = 0.0;
  for (const Wave& w : config.waves) {
    if (w.axis == axis) sum += w.amplitude * std::sin(2.0 * pi * w.hz * time_s + w.phase_rad);
  }
  return sum;
}

// The share of its usual speed that the platform has while it brakes, stands and accelerates.
double pace(const DriveConfig& config, double time_s) {
  double rate = 1.0;
  for (const Stop& stop : config.stops) {
    const double off = step((time_s - stop.at_s) / stop.ramp_s);
    const double on = step((time_s - stop.at_s - stop.ramp_s - stop.stand_s) / stop.ramp_s);
    rate *= 1.0 - off + on;
  }
  return rate;
}

void add_bumps(const DriveConfig& config, double time_s, Knot& knot) {
  for (const Bump& bump : config.bumps) {
    const double u = (time_s - bump.at_s) / bump.width_s;
    if (u <= 0.0 || u >= 1.0) continue;
    const double hill = step(2.0 * u) * step(2.0 * (1.0 - u));
    knot[2] += bump.height_m * hill;
    knot[4] -= bump.pitch_rad * hill * std::sin(2.0 * pi * u);
  }
}

// The knot of a pose, with the yaw unwrapped to be next to yaw_before.
Knot knot_of(const Pose& pose, double yaw_before) {
  const Eigen::Matrix3d& R = pose.linear();
  const double yaw = std::atan2(R(1, 0), R(0, 0));
  Knot knot;
  knot << pose.translation(), yaw_before + std::remainder(yaw - yaw_before, 2.0 * pi),
      std::asin(std::clamp(-R(2, 0), -1.0, 1.0)), std::atan2(R(2, 1), R(2, 2));
  return knot;
}

void shake(const DriveConfig& config, double time_s, Knot& knot) {
  const double gain = step((time_s - kStillS) / kEngageS);
  const auto wave = [&](Axis axis) { return gain * wave_sum(config, axis, time_s); };
  const double ahead = wave(Axis::kAhead), side = wave(Axis::kSide);
  knot[0] += std::cos(knot[3]) * ahead - std::sin(knot[3]) * side;
  knot[1] += std::sin(knot[3]) * ahead + std::cos(knot[3]) * side;
  knot[2] += wave(Axis::kUp);
  knot[3] += wave(Axis::kYaw);
  knot[4] += wave(Axis::kPitch);
  knot[5] += wave(Axis::kRoll);
  add_bumps(config, time_s, knot);
}

Trajectory shaken(const Trajectory& smooth, const DriveConfig& config) {
  std::vector<Knot> knots;
  double place_s = 0.0, yaw = 0.0;  // place_s: time within the smooth drive
  const double end_s = std::min(config.start_s + config.duration_s + 1.0, 600.0);
  for (double t = 0.0; t < end_s && place_s < smooth.duration_s(); t += kKnotStepS) {
    Knot knot = knot_of(smooth.at(place_s).T_world_body, yaw);
    yaw = knot[3];
    shake(config, t, knot);
    knots.push_back(knot);
    place_s += kKnotStepS * pace(config, t + 0.5 * kKnotStepS);
  }
  return {std::move(knots), kKnotStepS};
}

// Foliage does not count as an obstacle, because leaves may touch the lidar.
bool is_foliage(const simulator::World& world, int surface) {
  const auto i = static_cast<std::size_t>(surface);
  return surface >= 0 && i < world.shapes().size() && world.shapes()[i].density_per_m > 0.0;
}

double nearest(const Scene& scene, const Vector3d& place, double time_s) {
  const auto moving = scene.world.moving_at(time_s);
  double found = 1e9;
  for (int i = 0; i < 27; ++i) {
    const Vector3d towards(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
    if (towards.isZero()) continue;
    const auto hit = scene.world.cast({place, towards.normalized()}, 5.0, moving, 0.0);
    const bool solid = hit && !is_foliage(scene.world, hit.surface);
    if (solid) found = std::min(found, hit.range_m);
  }
  return found;
}

}  // namespace

Scene scene_of(const DriveConfig& config) {
  const auto made = simulator::make_scene(config.world, config.scene);
  return {made->world, shaken(driven(*made, config), config)};
}

std::uint32_t sweep_count(const Scene& scene, const DriveConfig& config) {
  const double seconds =
      std::min(config.duration_s, scene.trajectory.duration_s() - config.start_s);
  return static_cast<std::uint32_t>(std::max(0.0, std::floor(seconds * config.lidar.hz - 1e-6)));
}

Extremes extremes(const Scene& scene, const DriveConfig& config) {
  constexpr int kEvery = 50;
  Extremes out;
  const double end_s = config.start_s + sweep_count(scene, config) / config.lidar.hz;
  int i = 0;
  for (double t = config.start_s; t < end_s; t += 0.002, ++i) {
    const MotionState s = scene.trajectory.at(t);
    out.speed_mps = std::max(out.speed_mps, s.velocity_world.norm());
    out.acceleration_mps2 = std::max(out.acceleration_mps2, s.acceleration_world.norm());
    out.rate_radps = std::max(out.rate_radps, s.rate_body.norm());
    out.angular_acceleration_radps2 =
        std::max(out.angular_acceleration_radps2, s.angular_acceleration_body.norm());
    if (i % kEvery == 0) {
      out.nearest_m = std::min(out.nearest_m, nearest(scene, s.T_world_body.translation(), t));
    }
  }
  return out;
}

void require_possible(const Extremes& found, const Limits& limits) {
  const auto require = [](bool held, const std::string& what, double value) {
    if (!held) {
      throw std::invalid_argument("no possible drive: " + what + " " + std::to_string(value));
    }
  };
  require(found.speed_mps <= limits.speed_mps, "speed (m/s)", found.speed_mps);
  require(found.acceleration_mps2 <= limits.acceleration_mps2, "acceleration (m/s2)",
          found.acceleration_mps2);
  require(found.rate_radps <= limits.rate_radps, "angular rate (rad/s)", found.rate_radps);
  require(found.angular_acceleration_radps2 <= limits.angular_acceleration_radps2,
          "angular acceleration (rad/s2)", found.angular_acceleration_radps2);
  require(found.nearest_m >= limits.nearest_m, "nearest surface (m)", found.nearest_m);
}

}  // namespace zloam::search
