#include "beams.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <stdexcept>

#include "simulator/random.hpp"

namespace zloam::search {
namespace {

using Eigen::Vector3d;
using simulator::MovingShape;
using simulator::Random;
using simulator::Ray;
using std::numbers::pi;

constexpr double kNoiseLimitSigmas = 4.0;

double seconds(std::int64_t ns) { return static_cast<double>(ns) * 1e-9; }
double radians(double degrees) { return degrees * pi / 180.0; }

void check(const BeamConfig& c) {
  const bool held = c.rings >= 2 && c.rings <= 256 && c.columns >= 90 && c.columns <= 8192 &&
                    c.hz >= 1.0 && c.hz <= 50.0 && c.high_deg > c.low_deg && c.high_deg <= 80.0 &&
                    c.low_deg >= -80.0 && c.view_deg > 10.0 && c.view_deg <= 360.0 &&
                    c.noise_m >= 0.0 && c.max_range_m > c.min_range_m;
  if (!held) throw std::invalid_argument("lidar: a setting is outside of what a lidar has");
}

}  // namespace

BeamLidar::BeamLidar(const simulator::Scene& scene, const BeamConfig& config, std::uint64_t seed)
    : scene_(scene), config_(config), seed_(seed) {
  check(config_);
  if (config_.pattern != "beams") rosette_ = rosette_named(config_.pattern);
}

std::uint16_t BeamLidar::rings() const {
  return config_.has_rings && !rosette_ ? static_cast<std::uint16_t>(config_.rings) : 0;
}

std::uint32_t BeamLidar::period_ns() const {
  return static_cast<std::uint32_t>(std::llround(1e9 / config_.hz));
}

// The moving objects that can come within range during a revolution.
std::vector<std::size_t> BeamLidar::movers_near(std::int64_t start_ns) const {
  constexpr double kSlackM = 60.0;  // object and platform may approach each other for 0.5 s
  const Vector3d place = scene_.trajectory.at(seconds(start_ns)).T_world_body.translation();
  std::vector<std::size_t> near;
  for (std::size_t i = 0; i < scene_.world.movers().size(); ++i) {
    const auto state = scene_.world.movers()[i].track.at(seconds(start_ns));
    if ((state.place - place).norm() < config_.max_range_m + kSlackM) near.push_back(i);
  }
  return near;
}

// The measured range of a ray; 0: no return.
double BeamLidar::measured(const Ray& ray, std::span<const MovingShape> moving, Random& random,
                           float& intensity) const {
  const bool lost = random.chance(config_.dropout);
  const double noise_m = random.normal(config_.noise_m, kNoiseLimitSigmas);
  const auto hit = scene_.world.cast(ray, config_.max_range_m + 1.0, moving, 0.0);
  if (!hit || lost) return 0.0;
  const double nearness = config_.max_range_m / hit.range_m;
  const double signal = hit.reflectivity * hit.cos_incidence * nearness * nearness;
  const double range_m = hit.range_m + noise_m;
  const bool seen = signal > config_.detection_reflectivity && range_m > config_.min_range_m &&
                    range_m < config_.max_range_m;
  intensity = static_cast<float>(std::clamp(hit.reflectivity, 0.0, 255.0));
  return seen ? range_m : 0.0;
}

void BeamLidar::column(std::int64_t time_ns, double azimuth_rad,
                       const std::vector<std::size_t>& movers, PointVector& points,
                       std::uint32_t after_ns) const {
  constexpr double kDriftM = 0.1;
  const Pose pose = scene_.trajectory.at(seconds(time_ns)).T_world_body;
  const Vector3d ahead(std::cos(azimuth_rad), -std::sin(azimuth_rad), 0.0);
  const Vector3d across = pose.linear() * Vector3d(-ahead.y(), ahead.x(), 0.0);
  std::vector<MovingShape> moving;
  for (const std::size_t i : movers) {
    const Vector3d to =
        scene_.world.movers()[i].track.at(seconds(time_ns)).place - pose.translation();
    if (std::abs(to.dot(across)) < scene_.world.mover_radius(i) + kDriftM) {
      scene_.world.add_moving(i, seconds(time_ns), moving);
    }
  }
  const double per_ring =
      radians(config_.high_deg - config_.low_deg) / static_cast<double>(config_.rings - 1);
  for (std::size_t ring = 0; ring < config_.rings; ++ring) {
    const double elevation = radians(config_.low_deg) + per_ring * static_cast<double>(ring);
    const Vector3d direction =
        std::cos(elevation) * ahead + std::sin(elevation) * Vector3d::UnitZ();
    Random random(seed_, simulator::Stream::kReturns,
                  simulator::mixed(static_cast<std::uint64_t>(time_ns)) + ring);
    Point point{};
    const Ray ray{pose.translation(), pose.linear() * direction};
    const double range_m = measured(ray, moving, random, point.intensity);
    if (range_m <= 0.0) continue;
    const Eigen::Vector3f at = (range_m * direction).cast<float>();
    point.x = at.x();
    point.y = at.y();
    point.z = at.z();
    point.time_ns = after_ns;
    point.ring = config_.has_rings ? static_cast<std::uint16_t>(ring) : std::uint16_t{0};
    points.push_back(point);
  }
}

// Casts the shots of the lasers in turn, each along the rosette's direction at its own time.
void BeamLidar::trace(std::int64_t start_ns, const std::vector<std::size_t>& movers,
                      PointVector& points) const {
  const auto shots = static_cast<std::size_t>(rosette_->points_per_s / config_.hz);
  std::vector<MovingShape> moving;
  for (std::size_t shot = 0; shot < shots; ++shot) {
    const auto after_ns = static_cast<std::uint32_t>(
        std::floor(static_cast<double>(shot) * 1e9 / rosette_->points_per_s));
    const std::int64_t time_ns = start_ns + after_ns;
    const Pose pose = scene_.trajectory.at(seconds(time_ns)).T_world_body;
    moving.clear();
    for (const std::size_t i : movers) scene_.world.add_moving(i, seconds(time_ns), moving);
    const Vector3d direction = rosette_->direction(seconds(time_ns), shot % rosette_->lasers);
    Random random(seed_, simulator::Stream::kReturns,
                  simulator::mixed(static_cast<std::uint64_t>(time_ns)));
    Point point{};
    const double range_m =
        measured({pose.translation(), pose.linear() * direction}, moving, random, point.intensity);
    if (range_m <= 0.0) continue;
    const Eigen::Vector3f at = (range_m * direction).cast<float>();
    point.x = at.x();
    point.y = at.y();
    point.z = at.z();
    point.time_ns = after_ns;
    points.push_back(point);
  }
}

Turn BeamLidar::turn(std::int64_t start_ns) const {
  const std::vector<std::size_t> movers = movers_near(start_ns);
  Turn out;
  if (rosette_) trace(start_ns, movers, out.points);
  for (std::size_t c = 0; !rosette_ && c < config_.columns; ++c) {
    const double share = static_cast<double>(c) / static_cast<double>(config_.columns);
    const double azimuth_rad = 2.0 * pi * share;
    const double off = std::remainder(azimuth_rad - radians(config_.view_towards_deg), 2.0 * pi);
    if (std::abs(off) > radians(config_.view_deg) / 2.0) continue;
    const auto after_ns = static_cast<std::uint32_t>(share * period_ns());
    column(start_ns + after_ns, azimuth_rad, movers, out.points, after_ns);
  }
  // As for every source, the points' times count from the first point.
  const std::uint32_t first_ns = out.points.empty() ? 0 : out.points.front().time_ns;
  for (Point& p : out.points) p.time_ns -= first_ns;
  out.first_ns = start_ns + first_ns;
  return out;
}

}  // namespace zloam::search
