#pragma once
// Answers requests for this host's time, and asks the hosts that messages come from: a latency that
// starts on another host is meaningless without the clocks' offset.

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/messages/build.hpp"
#include "common/messages/keys.hpp"
#include "common/runtime/host_clock.hpp"
#include "common/runtime/stage.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// All functions may be called from any thread.
class HostTimes {
 public:
  HostTimes(const Identity& identity, const Keys& keys, zenoh::Session& session);

  /// From the last packet to now on this host, ms, corrected by the clocks' offset; nothing while
  /// that is not known to 5 ms. From this call on, the host that received the packet is asked.
  std::optional<double> since_last_packet_ms(const msg::Header& header, std::int64_t now_ns);
  /// Once a second; does not wait. Forgets the hosts that no message has come from for a minute: a
  /// container has another host name each time it is made. now_ns: monotonic.
  void ask(std::int64_t now_ns);
  /// host -> offset of its clock, for hosts that have answered and do not share this clock
  std::map<std::string, ClockOffset> offsets() const;
  std::uint64_t not_asked() const;

 private:
  struct Other {
    std::string stage, instance;
    HostClock clock;
    /// of the last message that came from there, monotonic
    std::int64_t named_ns = 0;
    /// the same kernel under another host name: a container
    bool same_clock = false;
  };
  struct Known {
    std::mutex mutex;
    std::map<std::string, Other> hosts;
    /// messages from hosts beyond the maximum number of hosts asked
    std::uint64_t not_asked = 0;
  };
  void ask(const std::string& host, const std::string& key);
  /// Clock offset of a stage's host, as far as it is known.
  std::optional<ClockOffset> offset_of(const msg::TracePoint& stage);

  std::string host_;
  /// an identifier shared by all processes that use this clock
  std::string boot_;
  Keys keys_;
  zenoh::Session& session_;
  /// shared with pending answers
  std::shared_ptr<Known> known_ = std::make_shared<Known>();
  std::optional<zenoh::Queryable> queryable_;
};

}  // namespace zloam::runtime
