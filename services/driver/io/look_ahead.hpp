#pragma once
// Of a recording the packets to come tell how late the first one was: receive times that were
// truncated, and a backlog at the start, move no trajectory.

#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "driver/decoder/makers.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {

class LookAhead {
 public:
  /// Reads the first second and a half.
  LookAhead(PacketSource& source, const DecodingOptions& options);

  /// As the source's, of which nothing is left out.
  Read next(Datagram& datagram);

  /// When the first data packet would have been received had it been as little late as any of the
  /// first; 0: its own receive time is as good.
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
  /// whose payload was handed out last
  Kept current_;
  bool ended_ = false;
  std::uint32_t sender_ = 0;
  std::uint32_t first_toh_us_ = 0;
  std::vector<Arrival> arrivals_;
  std::int64_t first_received_ns_ = 0;
};

}  // namespace zloam::driver
