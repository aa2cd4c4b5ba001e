#include "simulator/scanner.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "simulator/random.hpp"

namespace zloam::simulator {
namespace {

// Error codes that a range field can have instead of a range (page 12, table 4, UTM-30LX).
constexpr std::uint32_t kNoObject = 1;
constexpr std::uint32_t kTooNear = 2;
constexpr double kIntensityPerPercent = 40.0;  // the manufacturer's unit is arbitrary

double seconds(std::int64_t ns) { return 1e-9 * static_cast<double>(ns); }

}  // namespace

Scanner::Scanner(std::shared_ptr<const Scene> scene, const SimulationConfig& simulation,
                 const ScannerConfig& config)
    : scene_(std::move(scene)), simulation_(simulation), config_(config), motor_(config.motor) {
  const bool sound = scene_ != nullptr && config.first_step >= config.scanner.first_step &&
                     config.last_step <= config.scanner.last_step &&
                     config.first_step < config.last_step && config.noise_sigma_m >= 0.0 &&
                     config.dropout >= 0.0 && config.dropout <= 1.0 &&
                     config.max_range_m > config.min_range_m && config.min_range_m >= 0.0;
  if (!sound) throw std::invalid_argument("steps, noise, dropout or ranges of the scanner");
}

std::int64_t Scanner::line_count(double duration_s) const {
  return std::llround(1e9 * duration_s) / config_.scanner.turn_ns();
}

ScanLine Scanner::line(std::int64_t index) const {
  ScanLine line;
  line.time_ns = index * config_.scanner.turn_ns();
  line.counter_ms = config_.counter_ms + static_cast<std::uint32_t>(line.time_ns / 1'000'000);
  const std::vector<MovingShape> moving = scene_->world.moving_at(seconds(line.time_ns));
  for (int step = config_.first_step; step <= config_.last_step; ++step) {
    line.echoes.push_back(measure(step, line.time_ns, moving));
  }
  return line;
}

scip::Echo Scanner::measure(int step, std::int64_t step0_ns,
                            const std::vector<MovingShape>& moving) const {
  const std::int64_t time_ns = step0_ns + config_.scanner.step_ns(step);
  const double turn =
      static_cast<double>(step - config_.scanner.front_step) / config_.scanner.steps_per_turn;
  const double theta_rad = 2.0 * std::numbers::pi * turn;
  const Eigen::AngleAxisd rolled(motor_.angle_rad(seconds(time_ns)), Eigen::Vector3d::UnitX());
  const Pose T_world_lidar = scene_->trajectory.at(seconds(time_ns)).T_world_body *
                             Pose(simulation_.T_base_lidar.linear());
  const Pose T_world_scanner = T_world_lidar * rolled * config_.T_motor_scanner;
  Ray ray;
  ray.origin = T_world_scanner.translation();
  ray.direction =
      T_world_scanner.linear() * Eigen::Vector3d(std::cos(theta_rad), std::sin(theta_rad), 0.0);
  const Hit hit =
      scene_->world.cast(ray, config_.max_range_m + 1.0, moving, seconds(time_ns - step0_ns));
  Random random(simulation_.seed, Stream::kReturns, static_cast<std::uint64_t>(time_ns));
  const bool lost = random.chance(config_.dropout);
  const double noise_m = random.normal(config_.noise_sigma_m, config_.noise_limit_sigmas);
  scip::Echo echo{step, false, kNoObject, 0};
  if (!hit || lost) return echo;
  const double nearness = config_.max_range_m / hit.range_m;
  const double signal = hit.reflectivity * hit.cos_incidence * nearness * nearness;
  const double range_m = hit.range_m + noise_m;
  if (signal < config_.detection_reflectivity || range_m > config_.max_range_m) return echo;
  if (range_m < config_.min_range_m) return {step, false, kTooNear, 0};
  echo.range_mm = static_cast<std::uint32_t>(std::lround(1e3 * range_m));
  echo.intensity = static_cast<std::uint32_t>(std::lround(kIntensityPerPercent * hit.reflectivity));
  return echo;
}

}  // namespace zloam::simulator
