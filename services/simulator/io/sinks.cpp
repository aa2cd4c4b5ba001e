#include "simulator/io/sinks.hpp"

#include <arpa/inet.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <stdexcept>

#include "simulator/io/pacer.hpp"

namespace zloam::simulator {
namespace {

class PcapSink : public Sink {
 public:
  PcapSink(const std::string& path, bool nanoseconds) : file_(path), nanoseconds_(nanoseconds) {
    const std::vector<std::uint8_t> header = pcap_header(nanoseconds);
    file_.write(header.data(), header.size());
  }
  void put(std::span<const Datagram> datagrams) override {
    std::vector<std::uint8_t> bytes;
    for (const Datagram& datagram : datagrams) {
      append_pcap_record(datagram, nanoseconds_, bytes);
    }
    file_.write(bytes.data(), bytes.size());
  }
  void close() override { file_.close(); }

 private:
  OutputFile file_;
  bool nanoseconds_;
};

class PayloadSink : public Sink {
 public:
  explicit PayloadSink(const std::string& path) : file_(path) {}
  void put(std::span<const Datagram> datagrams) override {
    for (const Datagram& datagram : datagrams) {
      if (datagram.is_data()) {
        file_.write(datagram.payload.data(), datagram.payload.size());
      }
    }
  }
  void close() override { file_.close(); }

 private:
  OutputFile file_;
};

class UdpSink : public Sink {
 public:
  UdpSink(const std::string& address, std::uint16_t port, std::uint16_t position_port, double rate)
      : pacer_(rate) {
    for (sockaddr_in* target : {&data_, &position_}) {
      target->sin_family = AF_INET;
      if (inet_pton(AF_INET, address.c_str(), &target->sin_addr) != 1) {
        throw std::invalid_argument("'" + address + "' is not an IPv4 address");
      }
    }
    data_.sin_port = htons(port);
    position_.sin_port = htons(position_port);
    socket_ = socket(AF_INET, SOCK_DGRAM, 0);
    const int yes = 1;
    if (socket_ < 0 || setsockopt(socket_, SOL_SOCKET, SO_BROADCAST, &yes, sizeof yes) != 0) {
      throw std::runtime_error(std::string("no UDP socket: ") + std::strerror(errno));
    }
  }
  ~UdpSink() override {
    if (socket_ >= 0) {
      ::close(socket_);
    }
  }
  void put(std::span<const Datagram> datagrams) override {
    for (const Datagram& datagram : datagrams) {
      pacer_.wait_for(datagram.sent_ns);
      const sockaddr_in& target = datagram.is_data() ? data_ : position_;
      const ssize_t sent = sendto(socket_, datagram.payload.data(), datagram.payload.size(), 0,
                                  reinterpret_cast<const sockaddr*>(&target), sizeof target);
      // A missing receiver is not an error: the real sensor broadcasts.
      if (sent < 0 && errno != ECONNREFUSED) {
        throw std::runtime_error(std::string("sending failed: ") + std::strerror(errno));
      }
    }
  }
  void close() override {}

 private:
  Pacer pacer_;
  int socket_ = -1;
  sockaddr_in data_{};
  sockaddr_in position_{};
};

}  // namespace

std::unique_ptr<Sink> pcap_sink(const std::string& path, bool nanoseconds) {
  return std::make_unique<PcapSink>(path, nanoseconds);
}

std::unique_ptr<Sink> payload_sink(const std::string& path) {
  return std::make_unique<PayloadSink>(path);
}

std::unique_ptr<Sink> udp_sink(const std::string& address, std::uint16_t port,
                               std::uint16_t position_port, double rate) {
  return std::make_unique<UdpSink>(address, port, position_port, rate);
}

}  // namespace zloam::simulator
