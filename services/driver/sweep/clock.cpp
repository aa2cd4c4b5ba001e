#include "driver/sweep/clock.hpp"

#include <algorithm>

namespace zloam::driver {
namespace {

constexpr std::int64_t kHourUs = 3'600'000'000;
constexpr std::int64_t kHourNs = 1000 * kHourUs;
constexpr std::int64_t kWindowNs = 10'000'000'000;
constexpr std::int64_t kSlewPartsPerMillion = 100;

std::int64_t floor_to(std::int64_t value, std::int64_t step) {
  const std::int64_t rest = value % step;
  return value - (rest < 0 ? rest + step : rest);
}

}  // namespace

std::int64_t resolve_hour_ns(std::int64_t toh_us, std::int64_t reference_ns) {
  std::int64_t time_ns = floor_to(reference_ns, kHourNs) + 1000 * toh_us;
  if (time_ns - reference_ns > kHourNs / 2) time_ns -= kHourNs;
  if (reference_ns - time_ns > kHourNs / 2) time_ns += kHourNs;
  return time_ns;
}

std::int64_t toh_difference_us(std::uint32_t a_us, std::uint32_t b_us) {
  std::int64_t difference_us = static_cast<std::int64_t>(a_us) - static_cast<std::int64_t>(b_us);
  if (difference_us > kHourUs / 2) difference_us -= kHourUs;
  if (difference_us < -kHourUs / 2) difference_us += kHourUs;
  return difference_us;
}

void SensorClock::anchor(std::int64_t sensor_ns, std::uint32_t toh_us, std::int64_t received_ns,
                         std::int64_t packet_duration_ns) {
  std::int64_t epoch_ns = 0;
  if (mode_ == ClockMode::kUtc && received_ns != 0) {
    epoch_ns = resolve_hour_ns(toh_us, received_ns);
  } else if (mode_ == ClockMode::kReceive && received_ns != 0) {
    epoch_ns = received_ns - packet_duration_ns;
  } else if (anchored_) {
    // The sensor's clock was set and nothing else tells the time: go on right after what was.
    epoch_ns = to_epoch_ns(last_sensor_ns_) + packet_duration_ns;
  } else {
    epoch_ns = 1000 * static_cast<std::int64_t>(toh_us);
  }
  offset_ns_ = epoch_ns - sensor_ns;
  target_offset_ns_ = offset_ns_;
  window_open_ = false;
  anchored_ = true;
  last_advance_ns_ = sensor_ns;
  last_sensor_ns_ = sensor_ns;
}

void SensorClock::observe(std::int64_t sensor_ns, std::int64_t received_ns,
                          std::int64_t packet_duration_ns) {
  last_sensor_ns_ = sensor_ns;
  if (mode_ != ClockMode::kReceive || received_ns == 0) return;
  const std::int64_t offset_ns = received_ns - packet_duration_ns - sensor_ns;
  if (!window_open_) {
    window_open_ = true;
    window_start_ns_ = sensor_ns;
    window_least_ns_ = offset_ns;
  }
  window_least_ns_ = std::min(window_least_ns_, offset_ns);
  if (sensor_ns - window_start_ns_ >= kWindowNs) {
    target_offset_ns_ = window_least_ns_;
    window_open_ = false;
  }
}

void SensorClock::advance(std::int64_t sensor_ns) {
  const std::int64_t most_ns = (sensor_ns - last_advance_ns_) * kSlewPartsPerMillion / 1'000'000;
  last_advance_ns_ = sensor_ns;
  if (most_ns <= 0) return;
  offset_ns_ += std::clamp(target_offset_ns_ - offset_ns_, -most_ns, most_ns);
}

}  // namespace zloam::driver
