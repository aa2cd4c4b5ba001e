#pragma once
// Which datagrams are the sensor's: by the length of the payload, never by the port alone, and of
// one sensor only.

#include <cstdint>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {

enum class DatagramKind : std::uint8_t { kData, kPosition, kMalformed, kForeign };

class StreamFilter {
 public:
  /// port 0: any; sender 0: that of the first data packet.
  StreamFilter(std::uint16_t port, std::uint32_t sender) : port_(port), sender_(sender) {}

  /// kMalformed: on the sensor's own port, with the length of no packet.
  DatagramKind classify(const Datagram& datagram);

  std::uint64_t foreign() const { return foreign_; }
  std::uint32_t sender() const { return sender_; }
  std::uint16_t port() const { return port_; }

 private:
  DatagramKind stranger() {
    ++foreign_;
    return DatagramKind::kForeign;
  }

  std::uint16_t port_;
  std::uint32_t sender_;
  bool locked_ = false;
  std::uint64_t foreign_ = 0;
};

}  // namespace zloam::driver
