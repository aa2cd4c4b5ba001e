// The serial line to a scanner, with a pseudo-terminal in its place.

#include "driver/io/scip_link.hpp"

#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include "driver/io/scip_source.hpp"
#include "driver/scip/test_device.hpp"

namespace zloam::driver {
namespace {

/// The line's two ends: the device's, and one by which an earlier program has set it up.
class Line {
 public:
  Line() : device_(posix_openpt(O_RDWR | O_NOCTTY)) {
    if (device_ < 0 || grantpt(device_) != 0 || unlockpt(device_) != 0) return;
    name_ = ptsname(device_);
    earlier_ = open(name_.c_str(), O_RDWR | O_NOCTTY);
  }
  ~Line() {
    if (earlier_ >= 0) close(earlier_);
    if (device_ >= 0) close(device_);
  }
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;

  bool is_open() const { return earlier_ >= 0; }
  /// The device's end.
  int device() const { return device_; }
  const std::string& name() const { return name_; }
  termios settings() const {
    termios settings{};
    EXPECT_EQ(tcgetattr(earlier_, &settings), 0);
    return settings;
  }
  void set(const termios& settings) const { EXPECT_EQ(tcsetattr(earlier_, TCSANOW, &settings), 0); }

 private:
  int device_;
  int earlier_ = -1;
  std::string name_;
};

TEST(ScipSerialLine, NothingOfAnEarlierProgramsSettingsIsLeft) {
  const Line line;
  if (!line.is_open()) GTEST_SKIP() << "no pseudo-terminals here";
  termios settings = line.settings();
  settings.c_iflag |= static_cast<tcflag_t>(IXON | IXOFF | IXANY | INPCK | IGNPAR | ICRNL);
  settings.c_oflag |= static_cast<tcflag_t>(OPOST);
  settings.c_lflag |= static_cast<tcflag_t>(ICANON | ECHO | ISIG);
  settings.c_cflag |= static_cast<tcflag_t>(CRTSCTS | CSTOPB | PARODD);
  settings.c_cflag &= ~static_cast<tcflag_t>(CLOCAL);
  settings.c_cc[VTIME] = 5;
  line.set(settings);
  // Otherwise the rest would show nothing.
  ASSERT_NE(line.settings().c_cflag & CRTSCTS, 0U);
  ASSERT_EQ(line.settings().c_cflag & CLOCAL, 0U);

  const auto link = open_scip_device(line.name());
  const termios now = line.settings();
  EXPECT_EQ(now.c_iflag & (IXON | IXOFF | IXANY | INPCK | IGNPAR | ICRNL), 0U);
  EXPECT_EQ(now.c_oflag & OPOST, 0U);
  EXPECT_EQ(now.c_lflag & (ICANON | ECHO | ISIG), 0U);
  EXPECT_EQ(now.c_cflag & (CRTSCTS | CSTOPB | PARENB | PARODD), 0U);
  EXPECT_EQ(now.c_cflag & CSIZE, static_cast<tcflag_t>(CS8));
  EXPECT_NE(now.c_cflag & CLOCAL, 0U);
  EXPECT_NE(now.c_cflag & CREAD, 0U);
  EXPECT_EQ(now.c_cc[VMIN], 1);
  EXPECT_EQ(now.c_cc[VTIME], 0);
  EXPECT_EQ(cfgetispeed(&now), static_cast<speed_t>(B115200));
}

/// After a stall of the driver more bytes wait than the length of a published packet can tell.
TEST(ScipTcp, NoReadingIsLongerThanAPacketCanBe) {
  const int listening = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof name;
  ASSERT_EQ(bind(listening, reinterpret_cast<const sockaddr*>(&name), size), 0);
  ASSERT_EQ(listen(listening, 1), 0);
  ASSERT_EQ(getsockname(listening, reinterpret_cast<sockaddr*>(&name), &size), 0);
  const auto link = open_scip_device("tcp://127.0.0.1:" + std::to_string(ntohs(name.sin_port)));
  const int scanner = accept(listening, nullptr, nullptr);
  ASSERT_GE(scanner, 0);
  std::size_t longest = 0, left = 0;
  // Kernels let the window grow with what is read.
  for (int round = 0; round < 20; ++round) {
    const std::vector<char> sent(4 << 20, 'x');
    const ssize_t taken = send(scanner, sent.data(), sent.size(), MSG_DONTWAIT);
    ASSERT_GT(taken, 0);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    left += static_cast<std::size_t>(taken);
    while (left > 0) {
      std::vector<std::uint8_t> bytes;
      std::int64_t received_ns = 0;
      ASSERT_EQ(link->read(bytes, received_ns, 10'000), ScipLink::Read::kBytes);
      longest = std::max(longest, bytes.size());
      left -= bytes.size();
    }
  }
  close(scanner);
  close(listening);
  EXPECT_LE(longest, std::numeric_limits<std::uint16_t>::max());
}

/// A scanner at RS-232: it hears 19200 bit/s alone, until it is told to change to 115200.
class Rs232Scanner {
 public:
  explicit Rs232Scanner(const Line& line) : line_(line), thread_([this] { run(); }) {}
  ~Rs232Scanner() {
    ends_ = true;
    thread_.join();
  }
  Rs232Scanner(const Rs232Scanner&) = delete;
  Rs232Scanner& operator=(const Rs232Scanner&) = delete;

  bool measures() const { return measures_; }

 private:
  void run() {
    while (!ends_) {
      pollfd waiting{line_.device(), POLLIN, 0};
      if (poll(&waiting, 1, 10) <= 0) continue;
      std::array<char, 256> bytes{};
      const ssize_t size = read(line_.device(), bytes.data(), bytes.size());
      const termios settings = line_.settings();
      if (size <= 0 || cfgetospeed(&settings) != rate_) continue;
      hear({bytes.data(), static_cast<std::size_t>(size)});
    }
  }
  void hear(const std::string& bytes) {
    heard_ += bytes;
    for (std::size_t end = 0; (end = heard_.find('\n')) != std::string::npos;) {
      const std::string command = heard_.substr(0, end);
      heard_.erase(0, end + 1);
      const bool changes = command == "SS115200";
      if (changes) rate_ = B115200;
      const std::string reply =
          changes ? scip::answer(command, "00") : device_.respond_one(command);
      EXPECT_EQ(write(line_.device(), reply.data(), reply.size()),
                static_cast<ssize_t>(reply.size()));
    }
    measures_ = device_.measuring;
  }

  const Line& line_;
  scip::TestDevice device_;
  speed_t rate_ = B19200;
  std::string heard_;
  std::atomic<bool> ends_{false}, measures_{false};
  std::thread thread_;
};

TEST(ScipSerialLine, AScannerThatStartsAt19200IsChangedTo115200) {
  const Line line;
  if (!line.is_open()) GTEST_SKIP() << "no pseudo-terminals here";
  const Rs232Scanner scanner(line);
  const auto source = sweeps_of_scanner(line.name(), ScipSourceConfig{}, 10);
  // Of a busy machine; it takes four seconds.
  const auto ends = std::chrono::steady_clock::now() + std::chrono::seconds(90);
  DecodedSweep sweep;
  while (!scanner.measures() && std::chrono::steady_clock::now() < ends) source->pull(sweep);
  EXPECT_TRUE(scanner.measures());
  const termios now = line.settings();
  EXPECT_EQ(cfgetospeed(&now), static_cast<speed_t>(B115200));
}

}  // namespace
}  // namespace zloam::driver
