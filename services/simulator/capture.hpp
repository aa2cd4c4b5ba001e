#pragma once
// The simulator's output as bytes: datagrams in the order of sending, capture files and
// trajectories. Opens no file.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/se3.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator {

/// One UDP datagram from the sensor.
struct Datagram {
  std::int64_t sent_ns = 0;  ///< Unix time at which it is on the wire
  std::uint16_t port = vlp16::kDataPort;
  std::int64_t index =
      -1;  ///< number of the data packet; of the preceding one for position packets
  std::vector<std::uint8_t> payload;

  bool is_data() const { return port == vlp16::kDataPort; }
};

/// The datagrams of data packets [first, first + packets.size()) and of the position packets among
/// them. A packet is sent kSendDelayNs after its period ends.
inline constexpr std::int64_t kSendDelayNs = 60'000;
std::vector<Datagram> datagrams(const Sensor& sensor, std::int64_t first,
                                std::span<const DataPacket> packets);

/// Header of a pcap file with Ethernet frames; nanoseconds chooses the resolution of its stamps
/// (magic 0xA1B23C4D instead of 0xA1B2C3D4).
std::vector<std::uint8_t> pcap_header(bool nanoseconds);

/// Appends the record of one datagram: Ethernet, IPv4 and UDP headers, from 192.168.1.201 to the
/// broadcast address, as a sensor with factory settings sends it.
void append_pcap_record(const Datagram& datagram, bool nanoseconds, std::vector<std::uint8_t>& out);

/// One line of a TUM trajectory: time (s, 9 decimals), x y z (m), qx qy qz qw; with line end.
std::string tum_line(std::int64_t unix_ns, const Pose& pose);

/// "2024-01-01T00:00:10" with optional fraction, UTC, to nanoseconds since the Unix epoch. Throws
/// std::invalid_argument.
std::int64_t parse_utc(const std::string& text);

}  // namespace zloam::simulator
