#pragma once
// A spinning lidar of any number of beams, rate and field of view in a world of the simulator. All
// lasers of a column fire at once. Ranges, drop-outs and what is too dark to be seen are as those
// of the simulator's VLP-16.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "common/geometry/point.hpp"
#include "simulator/random.hpp"
#include "simulator/sensor.hpp"

namespace zloam::search {

struct BeamConfig {
  std::size_t rings = 16;
  double low_deg = -15.0;
  double high_deg = 15.0;
  std::size_t columns = 1800;  ///< a turn
  double hz = 10.0;            ///< turns a second
  double view_deg = 360.0;     ///< horizontal, whole
  double view_towards_deg = 0.0;
  double noise_m = 0.02;
  double dropout = 0.01;
  double min_range_m = 0.5;
  double max_range_m = 100.0;
  double detection_reflectivity = 10.0;  ///< as in simulator::SensorConfig
};

/// One turn, clockwise from straight ahead.
struct Turn {
  std::int64_t first_ns = 0;  ///< of its first point after the start of the motion
  PointVector points;         ///< frame lidar, each in the pose at its own time, in time order
};

class BeamLidar {
 public:
  /// Throws std::invalid_argument for settings outside their limits. The scene must outlive it.
  BeamLidar(const simulator::Scene& scene, const BeamConfig& config, std::uint64_t seed);

  std::uint32_t period_ns() const;
  /// The turn that begins so long after the start of the motion.
  Turn turn(std::int64_t start_ns) const;

 private:
  std::vector<std::size_t> movers_near(std::int64_t start_ns) const;
  void column(std::int64_t time_ns, double azimuth_rad, const std::vector<std::size_t>& movers,
              PointVector& points, std::uint32_t after_ns) const;
  double measured(const simulator::Ray& ray, std::span<const simulator::MovingShape> moving,
                  simulator::Random& random, float& intensity) const;

  const simulator::Scene& scene_;
  BeamConfig config_;
  std::uint64_t seed_;
};

}  // namespace zloam::search
