#pragma once
// The virtual VLP-16: casts each laser of each firing from the pose at its own instant, and writes
// the packets. Times are integer nanoseconds after the start of the simulation; the capture clock
// adds epoch_ns.

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "common/geometry/se3.hpp"
#include "simulator/trajectory.hpp"
#include "simulator/vlp16.hpp"
#include "simulator/world.hpp"

namespace zloam::simulator {

/// A world and a motion through it. The trajectory is that of a frame with its origin at the lidar
/// and the axes of the platform.
struct Scene {
  World world;
  Trajectory trajectory;
};

struct SensorConfig {
  ReturnMode mode = ReturnMode::kStrongest;
  double rotation_rpm = 600.0;  ///< 300 to 1200
  double start_azimuth_deg = 0.0;
  /// relative variation of the motor's speed, with a period of 5 s
  double speed_deviation = 1e-3;
  double noise_sigma_m = 0.02;  ///< noise of the range
  double noise_limit_sigmas = 4.0;
  double dropout = 0.01;  ///< share of the returns that are lost at random
  double min_range_m = 0.5;
  double max_range_m = 100.0;
  /// A perpendicular surface of this reflectivity (percent) is just detected at max_range_m;
  /// darker, farther or more slanted surfaces are not. 0: every surface is detected.
  double detection_reflectivity = 10.0;
  double reflectivity_sigma = 3.0;
  double range_bias_sigma_m = 0.0;  ///< constant offset of each laser, drawn once
  /// Full angle of the beam. Above 0, each shot consists of five rays, which gives second returns
  /// and mixed pixels.
  double divergence_mrad = 0.0;
};

struct SimulationConfig {
  SensorConfig sensor;
  std::uint64_t seed = 1;
  std::int64_t epoch_ns = 1'704'067'210'000'000'000;  ///< 2024-01-01T00:00:10 UTC
  /// Pose of the lidar in base_link. The trajectory remains that of the lidar's position.
  Pose T_base_lidar = Pose::Identity();
  /// Rotates and shifts the frame of the published ground truth.
  Pose T_truth_world = Pose::Identity();
};

/// One return, as it was encoded.
struct Return {
  std::int64_t time_ns;  ///< time of the firing, after the start
  double azimuth_deg;    ///< azimuth of the rotor at the firing, not rounded
  double range_m;        ///< in whole units of 2 mm
  std::uint8_t block;
  std::uint8_t channel;
  std::uint8_t laser;
  std::uint8_t reflectivity;
  int surface;  ///< as in Hit
};

struct DataPacket {
  std::int64_t time_ns = 0;  ///< time of the first firing, after the start
  vlp16::DataBytes bytes{};
};

class Sensor {
 public:
  /// Throws std::invalid_argument for settings outside their limits.
  Sensor(std::shared_ptr<const Scene> scene, const SimulationConfig& config);

  const SimulationConfig& config() const { return config_; }
  const Scene& scene() const { return *scene_; }

  /// Number of packets that begin within the duration (s).
  std::int64_t packet_count(double duration_s) const;
  std::int64_t packet_period_ns() const { return vlp16::packet_ns(config_.sensor.mode); }
  double duration_s() const { return scene_->trajectory.duration_s(); }

  /// The packet with this number, from 0. Depends only on scene, configuration and index; may be
  /// called from several threads. Appends its returns to `returns`, if given.
  DataPacket data_packet(std::int64_t index, std::vector<Return>* returns = nullptr) const;

  /// The position packet that follows data packet index (one after every kDataPerPosition).
  vlp16::PositionBytes position_packet(std::int64_t index) const;

  /// Angle of the rotor, degrees clockwise since the start, not wrapped.
  double rotor_deg(double time_s) const;
  /// Time at which the rotor passes this angle (degrees, not wrapped), s after the start.
  double rotor_time_s(double angle_deg) const;

  /// True poses in the frame of the ground truth, at a time after the start (s).
  Pose T_truth_lidar(double time_s) const;
  Pose T_truth_base(double time_s) const;

 private:
  struct Shot;
  struct Echo;
  struct Echoes;
  struct Movement;
  Shot shot(const MotionState& body, std::int64_t sequence_ns, int laser) const;
  std::vector<MovingShape> moving_near(const Shot& first, const Movement& movement) const;
  Echoes measure(const Shot& shot, std::span<const MovingShape> moving) const;
  Echoes detect(std::span<Echo> echoes) const;
  Echo cast(const Ray& ray, double weight, std::span<const MovingShape> moving,
            double after_s) const;
  void sequence(std::int64_t sequence_ns, int group, int half, const Movement& movement,
                DataPacket& packet, std::vector<Return>* returns) const;
  void write(const Echo& echo, const Shot& shot, int block, int channel, DataPacket& packet,
             std::vector<Return>* returns) const;

  std::shared_ptr<const Scene> scene_;
  SimulationConfig config_;
  std::array<double, vlp16::kLasers> cos_elevation_;
  std::array<double, vlp16::kLasers> sin_elevation_;
  std::array<double, vlp16::kLasers> bias_m_;
};

}  // namespace zloam::simulator
