#pragma once
// Connections to a SCIP device: a socket, a serial device, a recorded session.

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace zloam::driver {

/// This host's clock, ns since the Unix epoch.
inline std::int64_t wall_ns() {
  return std::chrono::nanoseconds(std::chrono::system_clock::now().time_since_epoch()).count();
}

/// The same as it was at the first call, continued evenly: setting the clock does not move it. It
/// stamps received bytes.
inline std::int64_t even_ns() {
  const auto steady_ns = [] {
    return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count();
  };
  static const std::int64_t base_ns = wall_ns() - steady_ns();
  return base_ns + steady_ns();
}

class ScipLink {
 public:
  enum class Read : std::uint8_t { kBytes, kNothing, kClosed };

  virtual ~ScipLink() = default;
  /// Waits up to timeout_ms. received_ns: of even_ns(). kClosed: the connection is lost,
  /// why() tells the reason; of a file: its end.
  virtual Read read(std::vector<std::uint8_t>& bytes, std::int64_t& received_ns,
                    int timeout_ms) = 0;
  virtual void write(const std::string& bytes) = 0;
  virtual std::string why() const { return {}; }
};

/// "tcp://192.168.0.10:10940" or "/dev/ttyACM0". was_silent: it did not answer when it was opened
/// before; a serial scanner is then told to leave the rate at which RS-232 scanners start. Throws
/// SourceError when it can't be opened.
std::unique_ptr<ScipLink> open_scip_device(const std::string& device, bool was_silent = false);

/// Replies as they were received: records of big-endian 32-bit seconds, microseconds and length,
/// and the bytes. Throws SourceError.
std::unique_ptr<ScipLink> open_scip_session(const std::string& path);

/// Empty, or what is wrong with a device's text.
std::string device_error(const std::string& device);

}  // namespace zloam::driver
