#pragma once
// Sinks for datagrams: files and the network. Part of the program, not of the library.

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "common/geometry/output_file.hpp"
#include "simulator/capture.hpp"

namespace zloam::simulator {

/// Its functions throw std::runtime_error if something can't be written, and std::invalid_argument
/// for a wrong address.
class Sink {
 public:
  virtual ~Sink() = default;
  virtual void put(std::span<const Datagram> datagrams) = 0;
  virtual void close() = 0;
};

std::unique_ptr<Sink> pcap_sink(const std::string& path, bool nanoseconds);
/// Writes the payloads of data packets, concatenated.
std::unique_ptr<Sink> payload_sink(const std::string& path);
/// Sends to an IPv4 address, paced so that `rate` seconds of the simulation pass in one second;
/// data packets to `port`, position packets to position_port.
std::unique_ptr<Sink> udp_sink(const std::string& address, std::uint16_t port,
                               std::uint16_t position_port, double rate);

}  // namespace zloam::simulator
