#pragma once
// A lidar in a world of the simulator: a spinning one of any number of beams, rate and field of
// view, all lasers of a column firing at once, or one that traces a rosette. Ranges, drop-outs and
// what is too dark to be seen are as those of the simulator's VLP-16.

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
  /// "beams", or the name of a rosette, whose view and points a second are its own
  std::string pattern = "beams";
  /// Whether a sweep says which laser a point is of. A rosette's never does.
  bool has_rings = true;
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

/// One turn, clockwise from straight ahead, or the part of a rosette of the same length.
struct Turn {
  std::int64_t first_ns = 0;  ///< of its first point after the start of the motion
  PointVector points;         ///< frame lidar, each in the pose at its own time, in time order
};

class BeamLidar {
 public:
  /// Throws std::invalid_argument for settings outside their limits. The scene must outlive it.
  BeamLidar(const simulator::Scene& scene, const BeamConfig& config, std::uint64_t seed);

  std::uint32_t period_ns() const;
  /// Of a sweep's message; 0: its points have none.
  std::uint16_t rings() const;
  /// The turn that begins so long after the start of the motion.
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
