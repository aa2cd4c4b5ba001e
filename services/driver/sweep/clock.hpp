#pragma once
// From a sensor's time since the top of the hour to time since the Unix epoch.

#include <cstdint>

#include "driver/sweep/decoded_sweep.hpp"

namespace zloam::driver {

/// How absolute time is found.
enum class ClockMode : std::uint8_t {
  kReceive,     // sensor's own time, tied to the receive (or capture) times by the least delay
  kUtc,         // the sensor's hour is UTC's (GPS locked): hour and date from the receive time
  kFreeRunning  // no receive times: the sensor's time, with the epoch as its first hour
};

/// t = hour(reference) + toh, moved by an hour where that is nearer to the reference: right when
/// the reference is right to half an hour.
std::int64_t resolve_hour_ns(std::int64_t toh_us, std::int64_t reference_ns);

/// (a - b) of two times of the hour, across its rollover: -1800 s ... +1800 s.
std::int64_t toh_difference_us(std::uint32_t a_us, std::uint32_t b_us);

/// Maps the sensor's unwrapped time to the epoch. The offset changes only in advance(), which is
/// called between sweeps, so that times within a sweep are the sensor's own.
class SensorClock {
 public:
  explicit SensorClock(ClockMode mode) : mode_(mode) {}

  /// Ties the clock anew: at the start, and when the sensor's clock was set. received_ns 0:
  /// unknown.
  void anchor(std::int64_t sensor_ns, std::uint32_t toh_us, std::int64_t received_ns,
              std::int64_t packet_duration_ns);

  /// Watches the delay of a packet (mode kReceive).
  void observe(std::int64_t sensor_ns, std::int64_t received_ns, std::int64_t packet_duration_ns);

  /// Follows the drift between sensor and receiver, by at most 100 parts in a million.
  void advance(std::int64_t sensor_ns);

  std::int64_t to_epoch_ns(std::int64_t sensor_ns) const { return sensor_ns + offset_ns_; }

 private:
  ClockMode mode_;
  bool anchored_ = false;
  std::int64_t offset_ns_ = 0;
  std::int64_t target_offset_ns_ = 0;
  std::int64_t window_start_ns_ = 0;
  std::int64_t window_least_ns_ = 0;
  bool window_open_ = false;
  std::int64_t last_advance_ns_ = 0;
  std::int64_t last_sensor_ns_ = 0;
};

}  // namespace zloam::driver
