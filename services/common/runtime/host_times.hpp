#pragma once
// Tells others what this host's clock shows, and asks those hosts that messages come from: a
// latency that begins on another host means nothing without it.

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

/// All of it from any thread.
class HostTimes {
 public:
  HostTimes(const Identity& identity, const Keys& keys, zenoh::Session& session);

  /// From the last packet to now on this host, ms, corrected by the clocks' offset; none while that
  /// is not known to 5 ms. The host that took the packet is asked from now on.
  std::optional<double> since_last_packet_ms(const msg::Header& header, std::int64_t now_ns);
  /// Once a second; does not wait.
  void ask();
  /// host -> its clock beside this one's, of those that have answered and don't share this clock
  std::map<std::string, ClockOffset> offsets() const;
  std::uint64_t not_asked() const;

 private:
  struct Other {
    std::string stage, instance;
    HostClock clock;
    /// the same kernel under another name: a container
    bool same_clock = false;
  };
  struct Known {
    std::mutex mutex;
    std::map<std::string, Other> hosts;
    /// messages of more hosts than are asked
    std::uint64_t not_asked = 0;
  };
  void ask(const std::string& host, const std::string& key);
  /// Of the clock of a stage's host beside this one's, as far as it is known.
  std::optional<ClockOffset> offset_of(const msg::TracePoint& stage);

  std::string host_;
  /// what processes say that share this clock
  std::string boot_;
  Keys keys_;
  zenoh::Session& session_;
  /// shared with answers under way
  std::shared_ptr<Known> known_ = std::make_shared<Known>();
  std::optional<zenoh::Queryable> queryable_;
};

}  // namespace zloam::runtime
