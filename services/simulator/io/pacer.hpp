#pragma once
// Delays datagrams that are sent live until their time has come.

#include <chrono>
#include <cstdint>
#include <optional>
#include <thread>

namespace zloam::simulator {

class Pacer {
 public:
  /// `rate` seconds of the simulation pass in one second.
  explicit Pacer(double rate) : rate_(rate) {}

  /// Waits until the time of a datagram that the sensor sends at sent_ns. The first call starts the
  /// clock.
  void wait_for(std::int64_t sent_ns) {
    using Clock = std::chrono::steady_clock;
    if (!first_ns_) {
      first_ns_ = sent_ns;
      start_ = Clock::now();
    }
    const double after_ns = static_cast<double>(sent_ns - *first_ns_) / rate_;
    std::this_thread::sleep_until(start_ +
                                  std::chrono::nanoseconds(static_cast<std::int64_t>(after_ns)));
  }

 private:
  double rate_;
  std::optional<std::int64_t> first_ns_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace zloam::simulator
