#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <optional>
#include <utility>
#include <vector>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::size_t kLargestDatagram = 65536;

class Socket {
 public:
  /// shared: other sockets with the same option may bind to this port.
  Socket(const std::string& address, std::uint16_t port, int buffer_bytes, bool shared) {
    fd_ = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd_ < 0) throw SourceError(std::string("UDP socket: ") + std::strerror(errno));
    const int on = 1;
    // Stamps when the kernel receives the packet, so that waiting in the queue does not count.
    setsockopt(fd_, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
    setsockopt(fd_, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
    if (setsockopt(fd_, SOL_SOCKET, SO_RCVBUFFORCE, &buffer_bytes, sizeof buffer_bytes) != 0) {
      setsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &buffer_bytes, sizeof buffer_bytes);
    }
    if (shared) setsockopt(fd_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    bind_to(address, port);
  }
  ~Socket() {
    if (fd_ >= 0) close(fd_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;

  /// Connects the socket, so that the kernel prefers it for datagrams of this sender. False if
  /// there is no route to the address.
  bool only_from(std::uint32_t sender) {
    sockaddr_in name{};
    name.sin_family = AF_INET;
    name.sin_addr.s_addr = htonl(sender);
    return connect(fd_, reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0;
  }

  void join(const std::string& group) {
    ip_mreqn membership{};
    membership.imr_multiaddr.s_addr = htonl(parse_ipv4(group));
    if (setsockopt(fd_, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof membership) != 0) {
      throw SourceError("multicast group " + group + ": " + std::strerror(errno));
    }
  }

  int fd() const { return fd_; }
  std::uint16_t port() const { return port_; }
  std::uint64_t dropped() const { return dropped_; }

  /// Halved, as the kernel doubles the requested size to cover its own overhead.
  int buffer_bytes() const {
    int bytes = 0;
    socklen_t size = sizeof bytes;
    getsockopt(fd_, SOL_SOCKET, SO_RCVBUF, &bytes, &size);
    return bytes / 2;
  }

  /// False if no datagram is waiting.
  bool receive(std::vector<std::uint8_t>& buffer, Datagram& datagram) {
    sockaddr_in sender{};
    iovec part{buffer.data(), buffer.size()};
    alignas(cmsghdr) std::array<char, 256> control{};
    msghdr message{};
    message.msg_name = &sender;
    message.msg_namelen = sizeof sender;
    message.msg_iov = &part;
    message.msg_iovlen = 1;
    message.msg_control = control.data();
    message.msg_controllen = control.size();
    const ssize_t size = recvmsg(fd_, &message, 0);
    if (size < 0) {
      if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) return false;
      throw SourceError("UDP port " + std::to_string(port_) + ": " + std::strerror(errno));
    }
    datagram = {};
    datagram.payload = {buffer.data(), static_cast<std::size_t>(size)};
    datagram.port = port_;
    datagram.sender = ntohl(sender.sin_addr.s_addr);
    read_control(message, datagram);
    return true;
  }

 private:
  void bind_to(const std::string& address, std::uint16_t port) {
    sockaddr_in name{};
    name.sin_family = AF_INET;
    name.sin_addr.s_addr = htonl(parse_ipv4(address));
    name.sin_port = htons(port);
    if (bind(fd_, reinterpret_cast<const sockaddr*>(&name), sizeof name) != 0) {
      const int why = errno;
      close(fd_);
      fd_ = -1;
      std::string text = "UDP port " + std::to_string(port) + " on " + address + ": ";
      text += why == EADDRINUSE ? "is in use by another program (ss -lunp shows which)"
                                : std::strerror(why);
      throw SourceError(text);
    }
    socklen_t size = sizeof name;
    getsockname(fd_, reinterpret_cast<sockaddr*>(&name), &size);
    port_ = ntohs(name.sin_port);
  }

  void read_control(msghdr& message, Datagram& datagram) {
    for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
      if (c->cmsg_level != SOL_SOCKET) continue;
      if (c->cmsg_type == SCM_TIMESTAMPNS) {
        timespec stamp{};
        std::memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
        datagram.received_ns =
            static_cast<std::int64_t>(stamp.tv_sec) * 1'000'000'000 + stamp.tv_nsec;
      } else if (c->cmsg_type == SO_RXQ_OVFL) {
        std::uint32_t dropped = 0;
        std::memcpy(&dropped, CMSG_DATA(c), sizeof dropped);
        dropped_ = dropped;
      }
    }
  }

  int fd_ = -1;
  std::uint16_t port_ = 0;
  std::uint64_t dropped_ = 0;
};

/// One port. If a sender is named, it has two sockets: unicasts from the sender arrive at the
/// socket connected to it, even when other programs listen to other sensors on this port.
/// Broadcasts do not reach a connected socket; they arrive at the unconnected socket of every
/// program.
class Port {
 public:
  Port(const UdpOptions& options, std::uint16_t port, int buffer_bytes)
      : open_(options.bind_address, port, buffer_bytes, options.sender != 0),
        clock_ahead_ns_(options.clock_ahead_ns) {
    if (!options.multicast_group.empty()) open_.join(options.multicast_group);
    if (options.sender == 0) return;
    tied_.emplace(options.bind_address, open_.port(), buffer_bytes, true);
    if (!tied_->only_from(options.sender)) tied_.reset();
  }

  bool receive(std::vector<std::uint8_t>& buffer, Datagram& datagram) {
    const bool received =
        (tied_ && tied_->receive(buffer, datagram)) || open_.receive(buffer, datagram);
    if (received && datagram.received_ns != 0) datagram.received_ns += clock_ahead_ns_;
    return received;
  }
  void wait_on(std::vector<pollfd>& ready) const {
    ready.push_back({open_.fd(), POLLIN, 0});
    if (tied_) ready.push_back({tied_->fd(), POLLIN, 0});
  }
  std::uint16_t port() const { return open_.port(); }
  std::uint64_t dropped() const { return open_.dropped() + (tied_ ? tied_->dropped() : 0); }
  int buffer_bytes() const { return open_.buffer_bytes(); }

 private:
  Socket open_;
  std::optional<Socket> tied_;
  std::int64_t clock_ahead_ns_;
};

class UdpSourceImpl : public UdpSource {
 public:
  explicit UdpSourceImpl(const UdpOptions& options)
      : options_(options),
        data_(options, options.data_port, options.receive_buffer_bytes),
        position_(options, options.position_port, options.receive_buffer_bytes / 16) {
    data_.wait_on(ready_);
    position_.wait_on(ready_);
  }

  Read next(Datagram& datagram, int timeout_ms) override {
    if (!fill()) {
      const int count = poll(ready_.data(), ready_.size(), timeout_ms);
      if (count < 0 && errno != EINTR)
        throw SourceError(std::string("poll: ") + std::strerror(errno));
      if (count <= 0 || !fill()) return Read::kTimeout;
    }
    datagram = take();
    ++datagrams_;
    return Read::kDatagram;
  }

  NamedCounts counts() const override {
    return {{"datagrams", datagrams_}, {"kernel_drops", data_.dropped() + position_.dropped()}};
  }

  std::string complaint() const override {
    const int got = data_.buffer_bytes();
    if (got >= options_.receive_buffer_bytes) return {};
    return "the kernel grants a receive buffer of " + std::to_string(got) + " bytes, wanted " +
           std::to_string(options_.receive_buffer_bytes) +
           "; raise it with: sysctl -w net.core.rmem_max=" +
           std::to_string(options_.receive_buffer_bytes);
  }

  std::uint16_t data_port() const override { return data_.port(); }
  std::uint16_t position_port() const override { return position_.port(); }

 private:
  /// A port's next datagram, kept while the other port's is older.
  struct Pending {
    std::vector<std::uint8_t> buffer = std::vector<std::uint8_t>(kLargestDatagram);
    Datagram datagram;
    bool there = false;
  };

  bool fill() {
    for (auto [port, pending] :
         {std::pair(&data_, &next_data_), std::pair(&position_, &next_position_)}) {
      if (!pending->there) pending->there = port->receive(pending->buffer, pending->datagram);
    }
    return next_data_.there || next_position_.there;
  }

  /// The older of both by the kernel's stamps. Otherwise, when the driver lags, a data port that
  /// always has a datagram would delay the other port's readings until after their sweep.
  Datagram take() {
    const bool data_first =
        next_data_.there && (!next_position_.there || next_data_.datagram.received_ns <=
                                                          next_position_.datagram.received_ns);
    Pending& oldest = data_first ? next_data_ : next_position_;
    oldest.there = false;
    return oldest.datagram;
  }

  UdpOptions options_;
  Port data_;
  Port position_;
  std::vector<pollfd> ready_;
  Pending next_data_;
  Pending next_position_;
  std::uint64_t datagrams_ = 0;
};

}  // namespace

std::unique_ptr<UdpSource> open_udp(const UdpOptions& options) {
  return std::make_unique<UdpSourceImpl>(options);
}

std::uint32_t parse_ipv4(const std::string& address) {
  if (address.empty()) return 0;
  in_addr parsed{};
  if (inet_pton(AF_INET, address.c_str(), &parsed) != 1) {
    throw SourceError("\"" + address + "\" is no IPv4 address such as 192.168.1.201");
  }
  return ntohl(parsed.s_addr);
}

std::string ipv4_text(std::uint32_t address) {
  return std::to_string(address >> 24) + "." + std::to_string((address >> 16) & 255U) + "." +
         std::to_string((address >> 8) & 255U) + "." + std::to_string(address & 255U);
}

}  // namespace zloam::driver
