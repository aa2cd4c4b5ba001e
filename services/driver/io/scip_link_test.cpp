// The serial line to a scanner, with a pseudo-terminal in its place.

#include "driver/io/scip_link.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <termios.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

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
  const std::string& name() const { return name_; }
  termios settings() const {
    termios settings{};
    EXPECT_EQ(tcgetattr(earlier_, &settings), 0);
    return settings;
  }
  void set(const termios& settings) const {
    EXPECT_EQ(tcsetattr(earlier_, TCSANOW, &settings), 0);
  }

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

}  // namespace
}  // namespace zloam::driver
