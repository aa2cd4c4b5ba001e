#include "simulator/sensor.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr double kMotorPeriodS = 5.0;
constexpr double kSecondReturnM = 1.0;  // hits closer to each other merge into one return
constexpr double kCentreWeight = 0.4;   // weights of the five rays across the beam
constexpr double kRimWeight = 0.15;
constexpr double kRimRadius = 0.35;  // share of the beam's full angle
constexpr double kReferenceLatitudeDeg = 48.0;
constexpr double kReferenceLongitudeDeg = 11.0;
constexpr double kMetresPerDegree = 111'320.0;

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }
double radians(double degrees) { return degrees * pi / 180.0; }

void require(bool condition, const char* message) {
  if (!condition) {
    throw std::invalid_argument(message);
  }
}

void check(const SensorConfig& config) {
  require(config.rotation_rpm >= 300.0 && config.rotation_rpm <= 1200.0,
          "rotation_rpm must be from 300 to 1200");
  require(config.speed_deviation >= 0.0 && config.speed_deviation < 0.1,
          "speed_deviation must be from 0 to below 0.1");
  require(config.noise_sigma_m >= 0.0 && config.noise_limit_sigmas >= 0.0,
          "noise must not be negative");
  require(config.dropout >= 0.0 && config.dropout <= 1.0, "dropout must be from 0 to 1");
  require(config.min_range_m >= 0.0 && config.max_range_m > config.min_range_m &&
              config.max_range_m <= 65535.0 * vlp16::kDistanceUnitM,
          "ranges must be 0 <= min < max <= 131.07 m");
  require(config.divergence_mrad >= 0.0 && config.divergence_mrad <= 20.0,
          "divergence_mrad must be from 0 to 20");
}

}  // namespace

/// One shot of one laser: its ray in the world frame, its time, azimuth and laser.
struct Sensor::Shot {
  Ray ray;
  Vector3d across;  // unit, perpendicular to the ray and to upward
  Vector3d upward;
  std::int64_t time_ns;
  double azimuth_deg;
  int laser;
};

/// One return of a shot.
struct Sensor::Echo {
  double range_m = 0.0;
  double reflectivity = 0.0;
  double signal = 0.0;  // reflected power relative to the detection limit; 0: no return
  int surface = kNoSurface;
};

/// The states of all moving objects at one time.
struct Sensor::Movement {
  std::int64_t time_ns;
  std::vector<Track::State> states;
};

struct Sensor::Echoes {
  Echo strongest;
  Echo last;
  Echo second;  // second strongest
};

Sensor::Sensor(std::shared_ptr<const Scene> scene, const SimulationConfig& config)
    : scene_(std::move(scene)), config_(config) {
  require(scene_ != nullptr, "a scene is needed");
  check(config_.sensor);
  for (std::size_t laser = 0; laser < vlp16::kLasers; ++laser) {
    cos_elevation_[laser] = std::cos(radians(vlp16::kElevationDeg[laser]));
    sin_elevation_[laser] = std::sin(radians(vlp16::kElevationDeg[laser]));
    Random random(config_.seed, Stream::kReturns, ~laser);
    bias_m_[laser] = random.normal(config_.sensor.range_bias_sigma_m, 3.0);
  }
}

std::int64_t Sensor::packet_count(double duration_s) const {
  return static_cast<std::int64_t>(duration_s * 1e9) / packet_period_ns();
}

double Sensor::rotor_deg(double time_s) const {
  const double number = 2.0 * pi / kMotorPeriodS;
  const double wander = config_.sensor.speed_deviation / number * std::sin(number * time_s);
  return config_.sensor.start_azimuth_deg + 6.0 * config_.sensor.rotation_rpm * (time_s + wander);
}

double Sensor::rotor_time_s(double angle_deg) const {
  const double rate = 6.0 * config_.sensor.rotation_rpm;
  double time_s = (angle_deg - config_.sensor.start_azimuth_deg) / rate;
  for (int i = 0; i < 20; ++i) {  // converges: the speed is within a tenth of the mean rate
    time_s += (angle_deg - rotor_deg(time_s)) / rate;
  }
  return time_s;
}

Sensor::Shot Sensor::shot(const MotionState& body, std::int64_t sequence_ns, int laser) const {
  // Within the 35 us of one sequence the motion is linearized; the error is below 1 um.
  const std::int64_t since_ns = laser * vlp16::kLaserNs;
  const double dt = seconds(since_ns);
  const auto i = static_cast<std::size_t>(laser);
  Shot shot;
  shot.time_ns = sequence_ns + since_ns;
  shot.laser = laser;
  shot.azimuth_deg = rotor_deg(seconds(shot.time_ns));
  const double cos_a = std::cos(radians(shot.azimuth_deg));
  const double sin_a = std::sin(radians(shot.azimuth_deg));
  const auto to_world = [&](const Vector3d& v_lidar) -> Vector3d {
    const Vector3d v = config_.T_base_lidar.linear() * v_lidar;
    return body.T_world_body.linear() * (v + dt * body.rate_body.cross(v));
  };
  const Vector3d direction(cos_elevation_[i] * cos_a, -cos_elevation_[i] * sin_a,
                           sin_elevation_[i]);
  shot.ray.direction = to_world(direction).normalized();
  shot.ray.origin = body.T_world_body.translation() + dt * body.velocity_world +
                    to_world(Vector3d(0.0, 0.0, vlp16::kHeightM[i]));
  shot.across = to_world(Vector3d(-sin_a, -cos_a, 0.0)).normalized();
  shot.upward = shot.ray.direction.cross(shot.across);
  return shot;
}

// The moving shapes that the firing sequence beginning with this shot may hit. Its lasers fire
// within one upright plane, which rotates by at most a quarter of a degree until the last of them.
std::vector<MovingShape> Sensor::moving_near(const Shot& first, const Movement& movement) const {
  constexpr double kSlack = 0.03;  // share of the distance: plane's rotation, half the widest beam
  constexpr double kDriftM = 0.1;  // bound on the deviation from straight motion within a packet
  const World& world = scene_->world;
  const double since_s = seconds(first.time_ns - movement.time_ns);
  std::vector<MovingShape> moving;
  for (std::size_t i = 0; i < movement.states.size(); ++i) {
    const Track::State& state = movement.states[i];
    const Vector3d to = state.place + since_s * state.velocity - first.ray.origin;
    const double distance = to.norm();
    const double radius = world.mover_radius(i) + kDriftM;
    const double reach = radius + kSlack * distance;
    if (distance < config_.sensor.max_range_m + radius && std::abs(to.dot(first.across)) < reach &&
        to.dot(first.ray.direction) > -reach) {
      world.add_moving(i, seconds(first.time_ns), moving);
    }
  }
  return moving;
}

Sensor::Echo Sensor::cast(const Ray& ray, double weight, std::span<const MovingShape> moving,
                          double after_s) const {
  const SensorConfig& sensor = config_.sensor;
  const Hit hit = scene_->world.cast(ray, sensor.max_range_m + 1.0, moving, after_s);
  if (!hit) {
    return {};
  }
  double signal = weight;
  if (sensor.detection_reflectivity > 0.0) {
    const double nearness = sensor.max_range_m / hit.range_m;
    signal *=
        hit.reflectivity * hit.cos_incidence * nearness * nearness / sensor.detection_reflectivity;
  } else {
    signal *= 1e3 / (hit.range_m * hit.range_m) + 1.0;
  }
  return {hit.range_m, hit.reflectivity, signal, hit.surface};
}

Sensor::Echoes Sensor::detect(std::span<Echo> echoes) const {
  std::sort(echoes.begin(), echoes.end(),
            [](const Echo& a, const Echo& b) { return a.range_m < b.range_m; });
  Echoes out;
  const double threshold = config_.sensor.detection_reflectivity > 0.0 ? 1.0 : 0.0;
  for (std::size_t i = 0; i < echoes.size();) {
    // Hits of the beam less than kSecondReturnM apart merge into one return at their centre, so
    // that two returns are never closer to each other than that.
    Echo joined = echoes[i];
    double moment = joined.signal * joined.range_m;
    std::size_t j = i + 1;
    for (; j < echoes.size() && echoes[j].range_m - echoes[j - 1].range_m < kSecondReturnM; ++j) {
      if (echoes[j].signal > joined.signal) {
        joined.surface = echoes[j].surface;
        joined.reflectivity = echoes[j].reflectivity;
      }
      joined.signal += echoes[j].signal;
      moment += echoes[j].signal * echoes[j].range_m;
    }
    i = j;
    if (joined.signal <= threshold) {
      continue;
    }
    joined.range_m = moment / joined.signal;
    out.last = joined;
    if (joined.signal > out.strongest.signal) {
      out.second = out.strongest;
      out.strongest = joined;
    } else if (joined.signal > out.second.signal) {
      out.second = joined;
    }
  }
  return out;
}

Sensor::Echoes Sensor::measure(const Shot& shot, std::span<const MovingShape> moving) const {
  const double after_s = seconds(shot.laser * vlp16::kLaserNs);
  const double divergence_rad = config_.sensor.divergence_mrad * 1e-3;
  std::array<Echo, 5> echoes;
  std::size_t count = 0;
  const auto add = [&](double across, double upward, double weight) {
    Ray ray = shot.ray;
    if (across != 0.0 || upward != 0.0) {
      ray.direction = (ray.direction + across * shot.across + upward * shot.upward).normalized();
    }
    const Echo echo = cast(ray, weight, moving, after_s);
    if (echo.surface != kNoSurface) {
      echoes[count++] = echo;
    }
  };
  if (divergence_rad <= 0.0) {
    add(0.0, 0.0, 1.0);
  } else {
    const double rim = kRimRadius * divergence_rad;
    add(0.0, 0.0, kCentreWeight);
    add(rim, 0.0, kRimWeight);
    add(-rim, 0.0, kRimWeight);
    add(0.0, rim, kRimWeight);
    add(0.0, -rim, kRimWeight);
  }
  return detect(std::span(echoes).first(count));
}

void Sensor::write(const Echo& echo, const Shot& shot, int block, int channel, DataPacket& packet,
                   std::vector<Return>* returns) const {
  const SensorConfig& sensor = config_.sensor;
  // Seeded by time and range: two different returns of one shot have independent noise, and one
  // return that is written to both blocks stays equal.
  Random random(config_.seed, Stream::kReturns,
                mixed(static_cast<std::uint64_t>(shot.time_ns)) ^
                    mixed(static_cast<std::uint64_t>(std::llround(echo.range_m * 1e6))));
  const bool lost = random.chance(sensor.dropout);
  const double noise = random.normal(sensor.noise_sigma_m, sensor.noise_limit_sigmas);
  const double shade = random.normal(sensor.reflectivity_sigma, 4.0);
  const double range = echo.range_m + noise + bias_m_[static_cast<std::size_t>(shot.laser)];
  if (echo.surface == kNoSurface || lost || range < sensor.min_range_m ||
      range > sensor.max_range_m) {
    return;
  }
  const auto counts = static_cast<std::uint16_t>(std::lround(range / vlp16::kDistanceUnitM));
  const auto reflectivity =
      static_cast<std::uint8_t>(std::lround(std::clamp(echo.reflectivity + shade, 0.0, 255.0)));
  vlp16::set_return(packet.bytes, block, channel, counts, reflectivity);
  if (returns != nullptr && counts > 0) {
    returns->push_back({shot.time_ns, shot.azimuth_deg, counts * vlp16::kDistanceUnitM,
                        static_cast<std::uint8_t>(block), static_cast<std::uint8_t>(channel),
                        static_cast<std::uint8_t>(shot.laser), reflectivity, echo.surface});
  }
}

void Sensor::sequence(std::int64_t sequence_ns, int group, int half, const Movement& movement,
                      DataPacket& packet, std::vector<Return>* returns) const {
  const MotionState body = scene_->trajectory.at(seconds(sequence_ns));
  const std::vector<MovingShape> moving = moving_near(shot(body, sequence_ns, 0), movement);
  for (int laser = 0; laser < vlp16::kLasers; ++laser) {
    const Shot fired = shot(body, sequence_ns, laser);
    const Echoes echoes = measure(fired, moving);
    const int channel = half * vlp16::kLasers + laser;
    if (config_.sensor.mode != ReturnMode::kDual) {
      const bool last = config_.sensor.mode == ReturnMode::kLast;
      write(last ? echoes.last : echoes.strongest, fired, group, channel, packet, returns);
      continue;
    }
    const bool same = echoes.last.range_m == echoes.strongest.range_m;
    const bool only = same && echoes.second.surface == kNoSurface;
    write(echoes.last, fired, 2 * group, channel, packet, returns);
    write(same && !only ? echoes.second : echoes.strongest, fired, 2 * group + 1, channel, packet,
          returns);
  }
}

DataPacket Sensor::data_packet(std::int64_t index, std::vector<Return>* returns) const {
  const ReturnMode mode = config_.sensor.mode;
  DataPacket packet{index * packet_period_ns(), vlp16::empty_packet(mode)};
  Movement movement{packet.time_ns, {}};
  for (const Mover& mover : scene_->world.movers()) {
    movement.states.push_back(mover.track.at(seconds(packet.time_ns)));
  }
  for (int group = 0; group < vlp16::groups(mode); ++group) {
    const std::int64_t group_ns = packet.time_ns + group * vlp16::kBlockNs;
    const double azimuth = rotor_deg(seconds(group_ns));
    const int copies = mode == ReturnMode::kDual ? 2 : 1;
    for (int copy = 0; copy < copies; ++copy) {
      vlp16::set_azimuth(packet.bytes, copies * group + copy, azimuth);
    }
    sequence(group_ns, group, 0, movement, packet, returns);
    sequence(group_ns + vlp16::kSequenceNs, group, 1, movement, packet, returns);
  }
  vlp16::set_stamp(packet.bytes, config_.epoch_ns + packet.time_ns);
  return packet;
}

vlp16::PositionBytes Sensor::position_packet(std::int64_t index) const {
  const std::int64_t time_ns = (index + 1) * packet_period_ns();
  const MotionState body = scene_->trajectory.at(seconds(time_ns));
  const Eigen::Vector3d place = T_truth_lidar(seconds(time_ns)).translation();
  const Eigen::Vector3d velocity = config_.T_truth_world.linear() * body.velocity_world;
  vlp16::Position position;
  position.unix_ns = config_.epoch_ns + time_ns;
  position.latitude_deg = kReferenceLatitudeDeg + place.y() / kMetresPerDegree;
  position.longitude_deg =
      kReferenceLongitudeDeg +
      place.x() / (kMetresPerDegree * std::cos(radians(kReferenceLatitudeDeg)));
  position.speed_m_s = velocity.head<2>().norm();
  const double course = std::atan2(velocity.x(), velocity.y()) * 180.0 / pi;
  position.course_deg = position.speed_m_s < 0.05 ? 0.0 : course < 0.0 ? course + 360.0 : course;
  return vlp16::position_packet(position);
}

Pose Sensor::T_truth_lidar(double time_s) const {
  Pose pose = scene_->trajectory.at(time_s).T_world_body;
  pose.linear() *= config_.T_base_lidar.linear();
  return config_.T_truth_world * pose;
}

Pose Sensor::T_truth_base(double time_s) const {
  return T_truth_lidar(time_s) * config_.T_base_lidar.inverse();
}

}  // namespace zloam::simulator
