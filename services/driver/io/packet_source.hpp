#pragma once
// Where packets come from: a socket, a capture file, a file of bare payloads.

#include <cstdint>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/geometry/imu_reading.hpp"

namespace zloam::driver {

/// A source that cannot be opened or read; what() names it and says why.
class SourceError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// One UDP datagram; payload is valid until the next call of next().
struct Datagram {
  std::span<const std::uint8_t> payload;
  /// kernel's receive time or capture time, ns since the Unix epoch; 0: unknown
  std::int64_t received_ns = 0;
  /// UDP destination port; 0: unknown
  std::uint16_t port = 0;
  /// IPv4 address of the sender, most significant byte first; 0: unknown
  std::uint32_t sender = 0;
};

enum class Read : std::uint8_t { kDatagram, kTimeout, kEnd };

using NamedCounts = std::vector<std::pair<std::string_view, std::uint64_t>>;

class PacketSource {
 public:
  virtual ~PacketSource() = default;
  /// Waits up to timeout_ms (live sources). Throws SourceError when the source breaks.
  virtual Read next(Datagram& datagram, int timeout_ms) = 0;
  /// Skipped input, by reason, with names for the status.
  virtual NamedCounts counts() const = 0;
  /// A sentence if the source ended early or is impaired; empty: neither.
  virtual std::string complaint() const { return {}; }
  /// Inertial readings that arrived beside the packets since the last call.
  virtual std::vector<ImuReading> take_imu() { return {}; }
};

struct UdpOptions {
  std::string bind_address = "0.0.0.0";
  /// 0: any free port, see UdpSource::data_port()
  std::uint16_t data_port = 2368;
  std::uint16_t position_port = 8308;
  int receive_buffer_bytes = 4 << 20;
  /// joined when not empty
  std::string multicast_group = {};
  /// only packets from this IPv4 address; 0: any. With it several programs, each for its own
  /// sensor, can listen on one port.
  std::uint32_t sender = 0;
  /// this process's clock minus the kernel's, ns: not 0 where it simulates another host
  std::int64_t clock_ahead_ns = 0;
};

class UdpSource : public PacketSource {
 public:
  virtual std::uint16_t data_port() const = 0;
  virtual std::uint16_t position_port() const = 0;
};

std::unique_ptr<UdpSource> open_udp(const UdpOptions& options);

/// pcap or pcapng: Ethernet with or without VLAN tags, Linux cooked 1 and 2, raw IP, loopback. All
/// UDP datagrams over IPv4 are returned. A file that ends within a record ends the source, with a
/// complaint, after the complete records.
std::unique_ptr<PacketSource> open_pcap(const std::string& path);

/// Payloads of one length (0: unknown, which is refused), concatenated, without receive times.
std::unique_ptr<PacketSource> open_payload_file(const std::string& path, std::size_t payload_bytes);

/// "192.168.1.201" to its number, 0 for an empty text. Throws SourceError.
std::uint32_t parse_ipv4(const std::string& address);
std::string ipv4_text(std::uint32_t address);

}  // namespace zloam::driver
