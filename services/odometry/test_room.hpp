#pragma once
// A ray-cast world for the tests: a closed room with boxes in it, seen by a spinning lidar that
// moves with a constant twist. Every point is cast from the pose at its own firing time.

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "odometry/odometry.hpp"

namespace zloam::odometry {

struct Box {
  Eigen::Vector3d min, max;
};

/// Range to the first surface of the room (seen from inside) or of a box (from outside).
inline double cast(const Box& room, const std::vector<Box>& boxes, const Eigen::Vector3d& origin,
                   const Eigen::Vector3d& direction) {
  const auto slab = [&](const Box& b, double& enter, double& leave) {
    enter = -std::numeric_limits<double>::infinity();
    leave = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 3; ++i) {
      const double a = (b.min[i] - origin[i]) / direction[i];
      const double c = (b.max[i] - origin[i]) / direction[i];
      enter = std::max(enter, std::min(a, c));
      leave = std::min(leave, std::max(a, c));
    }
  };
  double enter, leave;
  slab(room, enter, leave);
  double best = leave;
  for (const Box& b : boxes) {
    slab(b, enter, leave);
    if (enter < leave && enter > 0.0) best = std::min(best, enter);
  }
  return best;
}

struct TestWorld {
  Box room{{-9, -6, -1.2}, {8, 7, 2.3}};
  std::vector<Box> boxes{{{3, 2, -1.2}, {4.5, 3.1, 0.8}},
                         {{-5, -4, -1.2}, {-3.6, -2.2, 1.1}},
                         {{2, -5, -1.2}, {3, -3.8, 0.3}}};
};

struct TestSensor {
  int rings = 16;
  int columns = 900;
  std::uint32_t period_ns = 100000000;
  double noise_m = 0.0;
  Pose T_base_lidar = Pose::Identity();
};

/// T_world_base at a time, s.
using Motion = std::function<Pose(double)>;

/// One sweep that begins at begin_s, sorted by ring and time.
inline PointVector sweep_along(const TestWorld& world, const TestSensor& sensor,
                               const Motion& motion, double begin_s, unsigned seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  PointVector points;
  for (int ring = 0; ring < sensor.rings; ++ring) {
    const double elevation =
        sensor.rings == 1 ? 0.0
                          : (-15.0 + 30.0 * ring / (sensor.rings - 1)) * std::numbers::pi / 180;
    for (int column = 0; column < sensor.columns; ++column) {
      const double fraction = (column + 0.02 * ring) / sensor.columns;
      const double azimuth = std::numbers::pi * (1.0 - 2.0 * fraction);
      const Eigen::Vector3d beam(std::cos(elevation) * std::cos(azimuth),
                                 std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      const double time_s = fraction * sensor.period_ns * 1e-9;
      const Pose T_world_lidar = motion(begin_s + time_s) * sensor.T_base_lidar;
      const double range = cast(world.room, world.boxes, T_world_lidar.translation(),
                                T_world_lidar.linear() * beam) +
                           sensor.noise_m * noise(rng);
      const Eigen::Vector3f p = (range * beam).cast<float>();
      points.push_back({p.x(), p.y(), p.z(), 1.0F, static_cast<std::uint32_t>(time_s * 1e9),
                        static_cast<std::uint16_t>(ring), ReturnType::kStrongest, 0});
    }
  }
  return points;
}

/// A sweep that begins at T_world_base and moves with the body twist (m/s, rad/s).
inline PointVector sweep_of(const TestWorld& world, const TestSensor& sensor,
                            const Pose& T_world_base, const Vector6& twist_per_s, unsigned seed) {
  return sweep_along(
      world, sensor, [&](double time_s) { return T_world_base * exp_se3(twist_per_s * time_s); },
      0.0, seed);
}

/// Results along a motion; truth_end[k] is the true motion of base_link from the first sweep's end
/// to sweep k's end.
struct Drive {
  std::vector<OdometryResult> results;
  std::vector<Pose> truth_end;
};

inline Drive drive_along(const TestWorld& world, const TestSensor& sensor,
                         const OdometryConfig& config, const Motion& motion, int sweeps) {
  Drive out;
  Odometry odometry(config, sensor.T_base_lidar);
  const double period_s = sensor.period_ns * 1e-9;
  const Pose T_world_origin = motion(period_s);
  for (int k = 0; k < sweeps; ++k) {
    const PointVector points = sweep_along(world, sensor, motion, k * period_s, 100U + unsigned(k));
    FeatureSweep sweep;
    sweep.sweep = static_cast<std::uint64_t>(k);
    sweep.stamp_ns = 1000000000LL * 1000 + static_cast<std::int64_t>(k) * sensor.period_ns;
    sweep.period_ns = sensor.period_ns;
    sweep.range_noise_m = std::max(0.01, sensor.noise_m);
    sweep.less_flat = points;
    out.results.push_back(odometry.process(sweep));
    out.truth_end.push_back(T_world_origin.inverse() * motion((k + 1) * period_s));
  }
  return out;
}

/// Along a constant twist.
inline Drive drive(const TestWorld& world, const TestSensor& sensor, const OdometryConfig& config,
                   const Vector6& twist_per_s, int sweeps) {
  return drive_along(
      world, sensor, config, [&](double time_s) { return exp_se3(twist_per_s * time_s); }, sweeps);
}

/// The result as another instance receives it.
inline CommittedSweep committed(const OdometryResult& r, std::uint32_t period_ns) {
  CommittedSweep c{r.sweep,       r.prev_sweep, r.instant_ns,       period_ns, r.T_odom_base,
                   r.twist_per_s, r.health,     r.state_covariance, r.fit,     r.planes};
  if (r.inertia) c.inertia = unpacked(packed(*r.inertia));
  return c;
}

}  // namespace zloam::odometry
