#include "common/runtime/session_config.hpp"

#include <iterator>
#include <nlohmann/json.hpp>

namespace zloam::runtime {
namespace {

std::string text(const std::vector<std::string>& list) { return nlohmann::json(list).dump(); }

/// Where siblings that listen on this address are reached: "all interfaces" is no destination.
std::string destination(const std::string& host) {
  if (host == "0.0.0.0") return "127.0.0.1";
  return host == "[::]" ? "[::1]" : host;
}

}  // namespace

Endpoints endpoints_of(const ZenohConfig& config, const std::string& stage) {
  Endpoints e;
  if (config.base_port > 0) {
    for (std::size_t i = 0; i < std::size(kStageOrder); ++i) {
      const std::string port = ":" + std::to_string(config.base_port + static_cast<int>(i));
      if (stage == kStageOrder[i]) {
        e.listen.push_back("tcp/" + config.host + port);
      } else {
        e.connect.push_back("tcp/" + destination(config.host) + port);
      }
    }
  }
  if (!config.listen.empty()) {
    // A second instance, away from its stage's port: the first one is a sibling then.
    e.connect.insert(e.connect.end(), e.listen.begin(), e.listen.end());
    e.listen = config.listen;
  }
  if (e.listen.empty()) e.listen = {"tcp/" + config.host + ":0"};
  e.connect.insert(e.connect.end(), config.connect.begin(), config.connect.end());
  return e;
}

zenoh::Config session_config(const ZenohConfig& config, const Endpoints& endpoints) {
  zenoh::Config c = zenoh::Config::create_default();
  c.insert_json5("mode", "\"peer\"");
  c.insert_json5("listen/endpoints", text(endpoints.listen));
  c.insert_json5("connect/endpoints", text(endpoints.connect));
  c.insert_json5("connect/exit_on_failure", "false");
  c.insert_json5("connect/timeout_ms", "-1");
  c.insert_json5("connect/retry",
                 "{period_init_ms: 100, period_max_ms: 1000, period_increase_factor: 2}");
  c.insert_json5("scouting/multicast/enabled", "false");
  c.insert_json5("scouting/gossip/enabled", "true");
  c.insert_json5("timestamping/enabled", "true");
  c.insert_json5("transport/link/tx/lease", std::to_string(config.lease_ms));
  const std::string shm = "transport/shared_memory/";
  c.insert_json5(shm + "enabled", config.shared_memory ? "true" : "false");
  // Else Zenoh makes a segment for its own bookkeeping whatever "enabled" says, and ends where
  // there is no room for it.
  if (!config.shared_memory) c.insert_json5(shm + "mode", "\"lazy\"");
  const std::string optimization = shm + "transport_optimization/";
  c.insert_json5(optimization + "pool_size", std::to_string(std::int64_t{config.pool_mib} << 20));
  c.insert_json5(optimization + "message_size_threshold",
                 std::to_string(config.shared_memory_threshold));
  // Answers go through the socket: under load a shared chunk can be taken back on its way
  // (eclipse-zenoh/zenoh#2628), and a recovery must not be lost that way.
  c.insert_json5(optimization + "messages", "[\"put\"]");
  return c;
}

}  // namespace zloam::runtime
