#pragma once
// In a recording the following packets show how late the first one was: truncated receive times, or
// a backlog at the start, then do not shift the trajectory.

#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "driver/decoder/makers.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {

class LookAhead {
 public:
  /// Reads the first second and a half. sender: of the sensor; 0: that of the first data packet.
  LookAhead(PacketSource& source, const DecodingOptions& options, std::uint32_t sender = 0);

  /// As the source's next(); nothing is skipped.
  Read next(Datagram& datagram);

  /// Receive time of the first data packet if it had been delayed as little as any of the first
  /// ones; 0: its own receive time is as good.
  std::int64_t first_received_ns() const { return first_received_ns_; }

 private:
  struct Kept {
    std::vector<std::uint8_t> payload;
    Datagram datagram;
  };
  struct Arrival {
    std::int64_t received_ns;
    /// the sensor's own time after the first packet
    std::int64_t after_ns;
  };

  bool add(const Datagram& datagram);
  std::int64_t least_late() const;

  PacketSource& source_;
  Makers makers_;
  std::deque<Kept> kept_;
  /// the packet whose payload was returned last
  Kept current_;
  bool ended_ = false;
  std::uint32_t sender_;
  std::uint32_t first_toh_us_ = 0;
  std::vector<Arrival> arrivals_;
  std::int64_t first_received_ns_ = 0;
};

}  // namespace zloam::driver
