#pragma once
// From a sensor's time since the top of the hour to time since the Unix epoch.

#include <cstdint>
#include <utility>

#include "driver/sweep/decoded_sweep.hpp"

namespace zloam::driver {

/// How absolute time is determined.
enum class ClockMode : std::uint8_t {
  kReceive,     // sensor's own time, tied to the receive (or capture) times by the least delay
  kUtc,         // the sensor's hour is UTC's (GPS locked): hour and date from the receive time
  kFreeRunning  // no receive times: the sensor's time, with the epoch as its first hour
};

/// t = hour(reference) + toh, moved by an hour if that is nearer to the reference: correct if the
/// reference is correct to half an hour.
std::int64_t resolve_hour_ns(std::int64_t toh_us, std::int64_t reference_ns);

/// (a - b) of two times of the hour, across its rollover: -1800 s ... +1800 s.
std::int64_t toh_difference_us(std::uint32_t a_us, std::uint32_t b_us);

/// Maps the sensor's unwrapped time to the epoch. Tied once, at the first packet: from then on
/// intervals are the sensor's, whatever the host's clock does. Only the drift between both clocks
/// is followed, slowly, in advance(), which is called between sweeps, so that times within a sweep
/// are the sensor's own.
class SensorClock {
 public:
  /// paced: messages come once per revolution, so that even times are no sign of truncation.
  explicit SensorClock(ClockMode mode, bool paced = false) : mode_(mode), paced_(paced) {}

  /// Ties the clock. received_ns 0: unknown.
  void anchor(std::int64_t sensor_ns, std::uint32_t toh_us, std::int64_t received_ns,
              std::int64_t packet_duration_ns);

  /// Observes the delay of a packet, to detect that the host's clock was set.
  void observe(std::int64_t sensor_ns, std::int64_t received_ns, std::int64_t packet_duration_ns);

  /// Follows the drift between sensor and receiver, by at most 100 parts in a million.
  void advance(std::int64_t sensor_ns);

  std::int64_t to_epoch_ns(std::int64_t sensor_ns) const { return sensor_ns + offset_ns_; }

  /// By how much a packet was later than expected by this clock. Much below 0: it arrived before it
  /// was sent, by this host's clock.
  std::int64_t delay_ns(std::int64_t sensor_ns, std::int64_t received_ns) const {
    return received_ns - host_set_ns_ - first_delay_ns_ - to_epoch_ns(sensor_ns);
  }

  /// Detected step of the host's clock since the last call; 0: none.
  std::int64_t take_host_step_ns() { return std::exchange(host_step_ns_, 0); }

 private:
  /// Least and greatest delay over a stretch of both clocks.
  struct Window {
    bool open = false;
    std::int64_t sensor_start_ns = 0;
    std::int64_t received_start_ns = 0;
    std::int64_t least_ns = 0;
    std::int64_t most_ns = 0;

    void add(std::int64_t sensor_ns, std::int64_t received_ns, std::int64_t offset_ns);
    bool spans(std::int64_t sensor_ns, std::int64_t received_ns, std::int64_t span_ns) const;
  };

  void watch_host(std::int64_t sensor_ns, std::int64_t received_ns, std::int64_t offset_ns);
  std::int64_t truncated_ns() const;

  ClockMode mode_;
  bool paced_;
  std::int64_t offset_ns_ = 0;
  std::int64_t target_offset_ns_ = 0;
  /// from the sensor's time to the host's when tied; differs from offset_ns_ in UTC mode
  std::int64_t first_delay_ns_ = 0;
  std::int64_t last_advance_ns_ = 0;
  /// total steps of the host's clock since then, and the part not taken yet
  std::int64_t host_set_ns_ = 0;
  std::int64_t host_step_ns_ = 0;
  /// receive times are multiples of the grain, counted from the first one
  std::int64_t first_received_ns_ = 0;
  std::int64_t grain_ns_ = 0;
  Window drift_;
  Window step_;
};

}  // namespace zloam::driver
