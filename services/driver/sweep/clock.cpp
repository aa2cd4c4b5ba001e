#include "driver/sweep/clock.hpp"

#include <algorithm>
#include <cstdlib>
#include <numeric>

namespace zloam::driver {
namespace {

constexpr std::int64_t kHourUs = 3'600'000'000;
constexpr std::int64_t kHourNs = 1000 * kHourUs;
constexpr std::int64_t kWindowNs = 10'000'000'000;
constexpr std::int64_t kSlewPartsPerMillion = 100;
// The host's clock was set if the least delay of a window of 2 s differs by this much.
constexpr std::int64_t kStepWindowNs = 2'000'000'000;
constexpr std::int64_t kHostStepNs = 500'000'000;
// Receive times that are all multiples of this or more were truncated.
constexpr std::int64_t kCoarseNs = 10'000'000;

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

void SensorClock::Window::add(std::int64_t sensor_ns, std::int64_t received_ns,
                              std::int64_t offset_ns) {
  // The receiver's clock was set back: earlier delays are on another time base.
  if (!open || received_ns < received_start_ns) {
    *this = {true, sensor_ns, received_ns, offset_ns, offset_ns};
  }
  least_ns = std::min(least_ns, offset_ns);
  most_ns = std::max(most_ns, offset_ns);
}

/// At least half of the span must have passed for the receiver too: packets that were held up
/// arrive together, and their delays do not tell whether its clock was set.
bool SensorClock::Window::spans(std::int64_t sensor_ns, std::int64_t received_ns,
                                std::int64_t span_ns) const {
  return sensor_ns - sensor_start_ns >= span_ns && received_ns - received_start_ns >= span_ns / 2;
}

void SensorClock::anchor(std::int64_t sensor_ns, std::uint32_t toh_us, std::int64_t received_ns,
                         std::int64_t packet_duration_ns) {
  const std::int64_t sent_ns = received_ns - packet_duration_ns;
  std::int64_t epoch_ns = 1000 * static_cast<std::int64_t>(toh_us);
  if (mode_ == ClockMode::kUtc && received_ns != 0) {
    epoch_ns = resolve_hour_ns(toh_us, received_ns);
  } else if (mode_ == ClockMode::kReceive && received_ns != 0) {
    epoch_ns = sent_ns;
  }
  offset_ns_ = epoch_ns - sensor_ns;
  target_offset_ns_ = offset_ns_;
  first_delay_ns_ = sent_ns - epoch_ns;
  last_advance_ns_ = sensor_ns;
}

void SensorClock::observe(std::int64_t sensor_ns, std::int64_t received_ns,
                          std::int64_t packet_duration_ns) {
  if (received_ns == 0) return;
  if (first_received_ns_ == 0) first_received_ns_ = received_ns;
  if (grain_ns_ == 0 || grain_ns_ >= kCoarseNs) {
    grain_ns_ = std::gcd(grain_ns_, received_ns - first_received_ns_);
  }
  const std::int64_t offset_ns =
      received_ns - packet_duration_ns - sensor_ns - host_set_ns_ - first_delay_ns_;
  watch_host(sensor_ns, received_ns, offset_ns);
  if (mode_ != ClockMode::kReceive) return;
  drift_.add(sensor_ns, received_ns, offset_ns);
  if (drift_.spans(sensor_ns, received_ns, kWindowNs)) {
    target_offset_ns_ = drift_.least_ns + truncated_ns();
    drift_.open = false;
  }
}

/// The greatest truncation error of the receive times, by which the least delay is too small.
std::int64_t SensorClock::truncated_ns() const {
  return !paced_ && grain_ns_ >= kCoarseNs ? grain_ns_ : 0;
}

/// A delay that changed and then stays constant means that the host's clock was set; the run keeps
/// its time. A delay that keeps changing is a backlog.
void SensorClock::watch_host(std::int64_t sensor_ns, std::int64_t received_ns,
                             std::int64_t offset_ns) {
  step_.add(sensor_ns, received_ns, offset_ns);
  if (!step_.spans(sensor_ns, received_ns, std::max(kStepWindowNs, 2 * truncated_ns()))) return;
  step_.open = false;
  if (step_.most_ns - step_.least_ns > kHostStepNs / 2 + truncated_ns()) return;
  const std::int64_t apart_ns = step_.least_ns + truncated_ns() - offset_ns_;
  if (std::abs(apart_ns) < kHostStepNs) return;
  host_set_ns_ += apart_ns;
  host_step_ns_ += apart_ns;
  target_offset_ns_ = offset_ns_;
  drift_.open = false;
}

void SensorClock::advance(std::int64_t sensor_ns) {
  const std::int64_t most_ns = (sensor_ns - last_advance_ns_) * kSlewPartsPerMillion / 1'000'000;
  last_advance_ns_ = sensor_ns;
  if (most_ns <= 0) return;
  offset_ns_ += std::clamp(target_offset_ns_ - offset_ns_, -most_ns, most_ns);
}

}  // namespace zloam::driver
