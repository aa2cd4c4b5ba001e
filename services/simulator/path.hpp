#pragma once
// Makes a smooth path in the plane from way points, and a trajectory from a drive along it.

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <vector>

#include "simulator/trajectory.hpp"

namespace zloam::simulator {

using Polyline = std::vector<Eigen::Vector2d>;

/// A path given by equally spaced points; its curvature is continuous.
struct Path {
  double spacing_m = 0.01;
  Polyline points;
  double length_m() const { return spacing_m * static_cast<double>(points.size() - 1); }
  Eigen::Vector2d at(double s_m) const;
  /// Direction of travel, rad, continuous along the path (not wrapped).
  std::vector<double> headings() const;
  /// The closed path, repeated `laps` times. Throws std::invalid_argument if it does not end where
  /// it began.
  Path repeated(int laps) const;
};

/// Rounds the corners of the way points with the given radius and smooths the curvature over
/// smoothing_m. A closed path starts and ends at the first way point, which should lie on a
/// straight stretch. Throws std::invalid_argument if arcs would overlap.
Path smooth_path(const Polyline& way_points, double corner_radius_m, double smoothing_m,
                 bool closed);

/// How the platform follows a path.
struct Drive {
  double max_speed_m_s = 7.5;
  double max_lateral_m_s2 = 1.3;
  double acceleration_m_s2 = 1.5;
  double speed_variation = 0.2;  ///< relative amplitude of the speed's slow variation
  double still_s = 2.0;          ///< time at rest at the start
  double height_m = 1.9;         ///< height of the sensor over the ground
  double roll_deg = 0.6;         ///< amplitudes of the platform's sway: roll_deg, pitch_deg, bob_m
  double pitch_deg = 0.7;
  double bob_m = 0.03;
  double sway_hz = 0.9;
  double yaw_swing_deg = 0.0;  ///< amplitude of an oscillation in yaw while moving
  double yaw_swing_hz = 0.0;
  int laps = 1;                                  ///< rounds of a closed path, without a stop
  double heading_deg = 0.0;                      ///< constant yaw of the platform against the path
  std::function<double(double, double)> ground;  ///< height at x, y; absent: 0
};

/// The trajectory of the sensor's mounting point along the path: the platform stands still for
/// still_s, drives, slows down to a stop and stands for half a second.
Trajectory drive(const Path& path, const Drive& options, std::uint64_t seed);

}  // namespace zloam::simulator
