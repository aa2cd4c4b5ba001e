#include "simulator/motor.hpp"

#include <cmath>
#include <numbers>
#include <stdexcept>

namespace zloam::simulator {
namespace {

constexpr double kRadians = std::numbers::pi / 180.0;

}  // namespace

Motor::Motor(const MotorConfig& config) : config_(config) {
  const bool sound = config.speed_deg_s > 0.0 && config.amplitude_deg > 0.0 &&
                     config.reversal_s >= 0.0 && config.encoder_hz > 0.0 &&
                     config.encoder_step_deg >= 0.0 &&
                     0.5 * config.speed_deg_s * config.reversal_s < 2.0 * config.amplitude_deg;
  if (!sound) throw std::invalid_argument("the motor's speed, amplitude, reversal or encoder");
}

double Motor::sweep_s() const {
  switch (config_.kind) {
    case MotorKind::kStill:
      return 1.0;
    case MotorKind::kTurn:
      return 180.0 / config_.speed_deg_s;
    default:
      // The two ramps last reversal_s together, at half of the full speed on average.
      return 2.0 * config_.amplitude_deg / config_.speed_deg_s + 0.5 * config_.reversal_s;
  }
}

double Motor::angle_rad(double time_s) const {
  if (config_.kind == MotorKind::kStill) return kRadians * config_.still_deg;
  if (config_.kind == MotorKind::kTurn) return kRadians * config_.speed_deg_s * time_s;
  const double half_s = sweep_s();
  const double number = std::floor(time_s / half_s);
  const double since_s = time_s - number * half_s;
  const double ramp_s = 0.5 * config_.reversal_s;
  // Angle covered since the last reversal; the acceleration is constant in both ramps.
  const auto ramp = [&](double s) {
    return ramp_s > 0.0 ? 0.5 * config_.speed_deg_s / ramp_s * s * s : 0.0;
  };
  double way_deg = 0.0;
  if (since_s < ramp_s) {
    way_deg = ramp(since_s);
  } else if (since_s < half_s - ramp_s) {
    way_deg = ramp(ramp_s) + config_.speed_deg_s * (since_s - ramp_s);
  } else {
    way_deg = 2.0 * config_.amplitude_deg - ramp(half_s - since_s);
  }
  const bool up = std::fmod(number, 2.0) == 0.0;
  const double angle_deg = way_deg - config_.amplitude_deg;
  return kRadians * (up ? angle_deg : -angle_deg);
}

std::vector<AngleReading> Motor::readings(std::int64_t first, std::int64_t count) const {
  std::vector<AngleReading> all;
  const double step_rad = kRadians * config_.encoder_step_deg;
  for (std::int64_t i = first; i < first + count; ++i) {
    const double time_s = static_cast<double>(i) / config_.encoder_hz;
    const double angle_rad = this->angle_rad(time_s);
    const double told_rad =
        step_rad > 0.0 ? step_rad * std::round(angle_rad / step_rad) : angle_rad;
    all.push_back({std::llround(1e9 * (time_s + config_.encoder_delay_s)), told_rad});
  }
  return all;
}

}  // namespace zloam::simulator
