#pragma once
// A lidar in a world of the simulator. It either spins, with any number of beams, rate and field of
// view, where all lasers of a column fire at once; or it scans a rosette. Range noise, drop-outs
// and the detection limit are modelled as for the simulator's VLP-16.

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/point.hpp"
#include "rosette.hpp"
#include "simulator/random.hpp"
#include "simulator/sensor.hpp"

namespace zloam::search {

struct BeamConfig {
  /// "beams", or the name of a rosette, which has its own field of view and points per second
  std::string pattern = "beams";
  /// Whether the points of a sweep have rings. Those of a rosette never have.
  bool has_rings = true;
  std::size_t rings = 16;
  double low_deg = -15.0;
  double high_deg = 15.0;
  std::size_t columns = 1800;  ///< per revolution
  double hz = 10.0;            ///< revolutions per second
  double view_deg = 360.0;     ///< full horizontal angle
  double view_towards_deg = 0.0;
  double noise_m = 0.02;
  double dropout = 0.01;
  double min_range_m = 0.5;
  double max_range_m = 100.0;
  double detection_reflectivity = 10.0;  ///< as in simulator::SensorConfig
};

/// One revolution, clockwise from straight ahead, or a stretch of a rosette of the same duration.
struct Turn {
  std::int64_t first_ns = 0;  ///< time of its first point after the start of the motion
  PointVector points;         ///< frame lidar at each point's own time, in time order
};

class BeamLidar {
 public:
  /// Throws std::invalid_argument for settings outside their limits. The scene must outlive it.
  BeamLidar(const simulator::Scene& scene, const BeamConfig& config, std::uint64_t seed);

  std::uint32_t period_ns() const;
  /// The number of rings in a sweep's message; 0: its points have no rings.
  std::uint16_t rings() const;
  /// The revolution that begins at start_ns after the start of the motion.
  Turn turn(std::int64_t start_ns) const;

 private:
  std::vector<std::size_t> movers_near(std::int64_t start_ns) const;
  void column(std::int64_t time_ns, double azimuth_rad, const std::vector<std::size_t>& movers,
              PointVector& points, std::uint32_t after_ns) const;
  void trace(std::int64_t start_ns, const std::vector<std::size_t>& movers,
             PointVector& points) const;
  double measured(const simulator::Ray& ray, std::span<const simulator::MovingShape> moving,
                  simulator::Random& random, float& intensity) const;

  const simulator::Scene& scene_;
  BeamConfig config_;
  std::optional<Rosette> rosette_;
  std::uint64_t seed_;
};

}  // namespace zloam::search
