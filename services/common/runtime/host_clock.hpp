#pragma once
// Offset between another host's clock and this one's, from requests that are answered at once
// (docs/protocol.md section 10; the arithmetic is NTP's, RFC 5905 section 8).

#include <cstdint>
#include <deque>
#include <optional>

namespace zloam::runtime {

/// A request to another host, ns since the Unix epoch: the first and the last time by this host's
/// clock, the two between by the other's.
struct TimeExchange {
  std::int64_t asked_ns = 0, received_ns = 0, sent_ns = 0, answered_ns = 0;
};

/// The other clock minus this one; the true offset lies within the uncertainty, however asymmetric
/// the two directions are.
struct ClockOffset {
  std::int64_t offset_ns = 0, uncertainty_ns = 0;
};

class HostClock {
 public:
  /// Of the last 16 exchanges the one with the smallest round trip counts. An exchange that ends
  /// before it begins is ignored: a clock was set meanwhile. One that contradicts the best by more
  /// than any drift replaces all before it: a clock was set since.
  void add(const TimeExchange& exchange);
  /// Nothing before the first answer.
  std::optional<ClockOffset> offset() const;

 private:
  std::deque<ClockOffset> last_;
};

}  // namespace zloam::runtime
