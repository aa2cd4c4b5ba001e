#include "driver/io/scip_link.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstring>
#include <limits>
#include <string_view>
#include <thread>
#include <utility>

#include "driver/io/packet_source.hpp"

namespace zloam::driver {
namespace {

constexpr std::string_view kTcp = "tcp://";
constexpr int kConnectMs = 2000;
constexpr std::size_t kReadBytes = 1 << 15;
// The bytes of one reading are published as one packet, whose length has 16 bits.
static_assert(kReadBytes <= std::numeric_limits<std::uint16_t>::max());
// Bits per second of a serial line, which USB devices ignore. At the rate at which RS-232 scanners
// start, a line takes longer than a revolution.
constexpr speed_t kRate = B115200;
constexpr speed_t kRateAtStart = B19200;
// Stops a measurement, leaves SCIP 1, and sets kRate.
constexpr std::string_view kChangeRate = "QT\nSCIP2.0\nSS115200\n";
// Until the commands are sent and a scanner has answered them and changed its rate.
constexpr std::chrono::milliseconds kChangesRate{300};

struct HostPort {
  std::string host;
  std::uint16_t port = 0;
};

/// Parses host and port; the host is empty if the text is malformed.
HostPort host_and_port(const std::string& device) {
  const std::string rest = device.substr(kTcp.size());
  const std::size_t colon = rest.rfind(':');
  if (colon == std::string::npos || colon == 0) return {};
  std::uint16_t port = 0;
  const char* const end = rest.data() + rest.size();
  const auto [at, error] = std::from_chars(rest.data() + colon + 1, end, port);
  if (error != std::errc{} || at != end || port == 0) return {};
  return {rest.substr(0, colon), port};
}

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  Descriptor& operator=(Descriptor&&) = delete;
  int get() const { return fd_; }

 private:
  int fd_;
};

class Device : public ScipLink {
 public:
  Device(Descriptor fd, bool socket) : fd_(std::move(fd)), socket_(socket), buffer_(kReadBytes) {}

  Read read(std::vector<std::uint8_t>& bytes, std::int64_t& received_ns, int timeout_ms) override {
    pollfd waiting{fd_.get(), POLLIN, 0};
    if (poll(&waiting, 1, timeout_ms) <= 0) return Read::kNothing;
    const ssize_t size = ::read(fd_.get(), buffer_.data(), buffer_.size());
    received_ns = even_ns();
    if (size < 0 && (errno == EAGAIN || errno == EINTR)) return Read::kNothing;
    if (size <= 0) {
      why_ = size == 0 ? "the other side closed the connection" : std::strerror(errno);
      return Read::kClosed;
    }
    bytes.assign(buffer_.begin(), buffer_.begin() + size);
    return Read::kBytes;
  }

  void write(const std::string& bytes) override {
    // Commands are a few bytes: if one does not fit at once, the device has stopped reading.
    const ssize_t sent = socket_ ? send(fd_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL)
                                 : ::write(fd_.get(), bytes.data(), bytes.size());
    if (sent != static_cast<ssize_t>(bytes.size())) {
      why_ = sent < 0 ? std::strerror(errno) : "it takes no more bytes";
    }
  }

  std::string why() const override { return why_; }

 private:
  Descriptor fd_;
  bool socket_;
  std::vector<std::uint8_t> buffer_;
  std::string why_;
};

std::string connect_error(int fd, const addrinfo& address) {
  if (connect(fd, address.ai_addr, address.ai_addrlen) == 0) return {};
  if (errno != EINPROGRESS) return std::strerror(errno);
  pollfd waiting{fd, POLLOUT, 0};
  if (poll(&waiting, 1, kConnectMs) <= 0) return "no answer";
  int error = 0;
  socklen_t size = sizeof error;
  getsockopt(fd, SOL_SOCKET, SO_ERROR, &error, &size);
  return error == 0 ? "" : std::strerror(error);
}

std::unique_ptr<ScipLink> open_tcp(const std::string& device) {
  const HostPort at = host_and_port(device);
  addrinfo hints{};
  hints.ai_family = AF_INET;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const std::string port = std::to_string(at.port);
  if (const int error = getaddrinfo(at.host.c_str(), port.c_str(), &hints, &found); error != 0) {
    throw SourceError(device + ": " + gai_strerror(error));
  }
  const std::unique_ptr<addrinfo, decltype(&freeaddrinfo)> address(found, freeaddrinfo);
  Descriptor fd(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (fd.get() < 0) throw SourceError(device + ": " + std::strerror(errno));
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  setsockopt(fd.get(), SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
  if (const std::string error = connect_error(fd.get(), *address); !error.empty()) {
    throw SourceError(device + ": " + error);
  }
  return std::make_unique<Device>(std::move(fd), true);
}

/// 8 bits, no parity, one stop bit, no flow control, no modem lines, bytes as they are: cfmakeraw()
/// keeps the rest of what an earlier program has set.
void make_plain(termios& settings) {
  cfmakeraw(&settings);
  settings.c_iflag &= ~static_cast<tcflag_t>(INPCK | IGNPAR | IXON | IXOFF | IXANY);
  settings.c_cflag &= ~static_cast<tcflag_t>(CSIZE | PARENB | PARODD | CSTOPB | CRTSCTS);
  settings.c_cflag |= static_cast<tcflag_t>(CS8 | CLOCAL | CREAD);
  settings.c_cc[VMIN] = 1;
  settings.c_cc[VTIME] = 0;
  cfsetspeed(&settings, kRate);
}

/// Has no effect on a scanner at another rate, which receives noise. An error here is reported when
/// the line is set to kRate.
void change_rate(int fd, termios settings) {
  cfsetspeed(&settings, kRateAtStart);
  if (tcsetattr(fd, TCSANOW, &settings) != 0) return;
  if (::write(fd, kChangeRate.data(), kChangeRate.size()) < 0) return;
  std::this_thread::sleep_for(kChangesRate);
}

std::unique_ptr<ScipLink> open_serial(const std::string& device, bool was_silent) {
  Descriptor fd(open(device.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (fd.get() < 0) {
    const bool denied = errno == EACCES;
    throw SourceError(device + ": " + std::strerror(errno) +
                      (denied ? "; is this user in the group dialout?" : ""));
  }
  termios settings{};
  if (tcgetattr(fd.get(), &settings) != 0) {
    throw SourceError(device + ": is no serial device");
  }
  make_plain(settings);
  if (was_silent) change_rate(fd.get(), settings);
  if (tcsetattr(fd.get(), TCSANOW, &settings) != 0) {
    throw SourceError(device + ": " + std::strerror(errno));
  }
  // Answers at the other rate.
  if (was_silent) tcflush(fd.get(), TCIFLUSH);
  return std::make_unique<Device>(std::move(fd), false);
}

}  // namespace

std::string device_error(const std::string& device) {
  if (device.starts_with(kTcp)) {
    return host_and_port(device).host.empty() ? "is no tcp://host:port" : "";
  }
  return device.starts_with('/') ? ""
                                 : "is neither tcp://host:port nor a path such as /dev/ttyACM0";
}

std::unique_ptr<ScipLink> open_scip_device(const std::string& device, bool was_silent) {
  return device.starts_with(kTcp) ? open_tcp(device) : open_serial(device, was_silent);
}

}  // namespace zloam::driver
