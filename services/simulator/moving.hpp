#pragma once
// Moving objects of a world: solids that follow a track.

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <vector>

#include "simulator/path.hpp"
#include "simulator/shape.hpp"

namespace zloam::simulator {

/// A place on a track at a time. Between two keys, place and direction are interpolated linearly.
struct TrackKey {
  double time_s = 0.0;
  Eigen::Vector3d place = Eigen::Vector3d::Zero();
  double yaw_rad = 0.0;
};

/// The motion of an object. A repeating track ends where it began; on any other the object stands
/// still before the first and after the last key.
class Track {
 public:
  Track() = default;
  /// Keys in ascending time. start_s shifts all of them to earlier times.
  Track(std::vector<TrackKey> keys, bool repeats, double start_s = 0.0);

  struct State {
    Eigen::Vector3d place = Eigen::Vector3d::Zero();
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
    double yaw_rad = 0.0;
  };
  State at(double time_s) const;

 private:
  std::vector<TrackKey> keys_;
  bool repeats_ = false;
  double start_s_ = 0.0;
};

enum class Repeat : std::uint8_t { kOnce, kLoop, kToAndFro };

/// A track along the points at constant speed, facing the direction of travel; start_m is the
/// distance already travelled at time 0. ground gives the height at x, y; absent: 0. Throws
/// std::invalid_argument for fewer than two points or a speed that is not positive.
Track walk(Polyline points, double speed_m_s, double start_m, Repeat repeat,
           const std::function<double(double, double)>& ground);

/// Solids that move together. Their frame: x forward, z up, origin on the track.
struct Mover {
  std::vector<Shape> shapes;
  Track track;
};

/// One solid at one instant.
struct MovingShape {
  Shape shape;
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();  ///< m/s
  int surface = 0;                                     ///< as in Hit
};

/// A car of 4.4 m (or a van of 5 m) and a person walking.
Mover car(bool van, double reflectivity, Track track);
Mover person(double height_m, Track track);

}  // namespace zloam::simulator
