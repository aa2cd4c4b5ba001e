#pragma once
// How far another host's clock is from this one's, from questions that were answered at once
// (docs/protocol.md section 10; the arithmetic is NTP's, RFC 5905 section 8).

#include <cstdint>
#include <deque>
#include <optional>

namespace zloam::runtime {

/// A question to another host, ns since the Unix epoch: the first and the last by this host's
/// clock, the two between by the other's.
struct TimeExchange {
  std::int64_t asked_ns = 0, received_ns = 0, sent_ns = 0, answered_ns = 0;
};

/// The other clock minus this one; the truth lies within the uncertainty, however unlike the two
/// ways are.
struct ClockOffset {
  std::int64_t offset_ns = 0, uncertainty_ns = 0;
};

class HostClock {
 public:
  /// Of the last 16 that with the smallest round trip counts. One that ends before it begins is
  /// ignored: a clock was set meanwhile.
  void add(const TimeExchange& exchange);
  /// None before the first answer.
  std::optional<ClockOffset> offset() const;

 private:
  std::deque<ClockOffset> last_;
};

}  // namespace zloam::runtime
