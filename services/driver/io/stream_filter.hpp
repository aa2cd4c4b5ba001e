#pragma once
// Selects the sensor's datagrams: by its maker's packet format, never by the port alone, and of one
// sensor only.

#include <cstdint>
#include <vector>

#include "driver/decoder/makers.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {

enum class DatagramKind : std::uint8_t {
  kData,
  kPosition,
  kImu,
  kMalformed,  // on the sensor's own port, but not a packet of it
  kForeign,
  kNewcomer,  // a data packet of another sender while the sensor is silent: perhaps the sensor
  kAdopted,   // as kData: the newcomer is the sensor, with another address
  kReturned,  // as kData: the sensor is back at its first address, the newcomer was another one
};

/// The sensor is the first sender of a data packet. Another sender replaces it only while it is
/// silent, and only if the two were not received at the same time: so a sensor that restarts with
/// another address is followed, and a second sensor is not.
class StreamFilter {
 public:
  /// port 0: any; sender 0: that of the first data packet. makers: settled by that packet.
  StreamFilter(std::uint16_t port, std::uint32_t sender, Makers& makers)
      : makers_(makers), port_(port), sender_(sender), any_sender_(sender == 0) {}

  DatagramKind classify(const Datagram& datagram);

  std::uint64_t foreign() const { return foreign_ + static_cast<std::uint64_t>(newcomer_packets_); }
  std::uint32_t sender() const { return sender_; }
  std::uint16_t port() const { return port_; }
  /// Sender of the last data packet that was skipped; 0: none.
  std::uint32_t other_sender() const { return other_sender_; }
  /// Another sensor that keeps sending at the same time as this one, if none was named; 0: none.
  std::uint32_t second_sensor() const { return second_sensor_; }

 private:
  DatagramKind stranger() {
    ++foreign_;
    return DatagramKind::kForeign;
  }
  bool of_sensor(const Datagram& datagram) const {
    return sender_ == 0 || datagram.sender == 0 || datagram.sender == sender_;
  }
  DatagramKind other_sender(const Datagram& datagram);
  DatagramKind data(const Datagram& datagram);
  void no_newcomer();
  bool silent_until(std::int64_t received_ns) const;

  Makers& makers_;
  std::uint16_t port_;
  std::uint32_t sender_;
  bool any_sender_;
  bool locked_ = false;
  std::uint32_t first_sender_ = 0;
  std::uint32_t other_sender_ = 0;
  std::int64_t last_received_ns_ = 0;
  std::uint32_t newcomer_ = 0;
  int newcomer_packets_ = 0;
  /// received at the same time as the sensor
  std::vector<std::uint32_t> others_;
  std::uint64_t packets_of_others_ = 0;
  std::uint32_t second_sensor_ = 0;
  std::uint64_t foreign_ = 0;
};

}  // namespace zloam::driver
