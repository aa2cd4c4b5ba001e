#pragma once
// One output key: consecutive numbers, delivery as in the key table, and the last messages kept for
// requests by number (docs/protocol.md, section 3): get <key>?run=R;sweep=a..b, or ?seq=a..b for
// keys without sweeps. A reply has the very bytes that were published.

#include <cstdint>
#include <string>

#include "common/messages/build.hpp"
#include "common/messages/header.hpp"
#include "common/runtime/inlet.hpp"

namespace zloam::runtime {

class Outlet {
 public:
  virtual ~Outlet() = default;
  virtual const std::string& key() const = 0;
  /// Whether there is a subscriber now: for data that is only computed then.
  virtual bool matching() const = 0;

  /// Header of the next message: the cause's, with this publisher's number, instance, term and
  /// trace point. Call it when the work is done: it takes the time of publication. Sensor, frame,
  /// odom epoch and map id stay the cause's unless changed.
  virtual HeaderFields header(const Message& cause) = 0;
  /// For sources: fills in robot, sensor, instance, number and trace point.
  virtual HeaderFields header(std::int64_t received_ns, std::int64_t started_ns) = 0;

  /// Sends without a copy; header must be the one that the message was built with. Blocks in replay
  /// while a reader is slow.
  virtual void publish(const HeaderFields& header, Buffer message) = 0;
  /// The same under another key (map tiles), with separate numbers below this outlet's key.
  virtual void publish_at(const std::string& key, const HeaderFields& header, Buffer message) = 0;
  /// Publishes the kept message of that sweep again, as it was; false when it is not kept.
  virtual bool publish_again(std::uint64_t run, std::uint64_t sweep) = 0;

  virtual std::uint64_t published() const = 0;
};

}  // namespace zloam::runtime
