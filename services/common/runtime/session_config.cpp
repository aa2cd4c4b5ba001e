#include "common/runtime/session_config.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>
#include <string_view>
#include <utility>

#include "common/runtime/parameters.hpp"
#include "common/runtime/whole_number.hpp"

namespace zloam::runtime {
namespace {

std::string text(const std::vector<std::string>& list) { return nlohmann::json(list).dump(); }

constexpr std::string_view kStage = "<stage>";

bool has_own_hosts(const ZenohConfig& config) {
  return config.host.find(kStage) != std::string::npos;
}

std::string listen_address(const ZenohConfig& config) {
  return has_own_hosts(config) ? "0.0.0.0" : config.host;
}

/// "All interfaces" is not a destination: this host is meant.
std::string_view destination(std::string_view host) {
  if (host == "0.0.0.0") return "127.0.0.1";
  return host == "[::]" ? "[::1]" : host;
}

/// The address at which a stage is reached.
std::string address_of(const ZenohConfig& config, const std::string& stage) {
  std::string host = config.host;
  if (has_own_hosts(config)) return host.replace(host.find(kStage), kStage.size(), stage);
  return std::string(destination(host));
}

struct HostPort {
  std::string_view host;
  std::uint16_t port = 0;
};

/// Host and port of a TCP endpoint. Zenoh's options, which begin with "?" or "#", are skipped.
std::optional<HostPort> host_and_port(std::string_view endpoint) {
  constexpr std::string_view kProtocol = "tcp/";
  if (!endpoint.starts_with(kProtocol)) return std::nullopt;
  const std::string_view address =
      endpoint.substr(kProtocol.size(), endpoint.find_first_of("?#") - kProtocol.size());
  const auto colon = address.rfind(':');
  if (colon == std::string_view::npos || colon == 0) return std::nullopt;
  if (address.find_first_of(" /") != std::string_view::npos) return std::nullopt;
  const auto port = whole_number<std::uint16_t>(address.substr(colon + 1));
  if (!port) return std::nullopt;
  return HostPort{address.substr(0, colon), *port};
}

/// Whether the host is given as the numeric address of another host.
bool is_address(std::string_view host) {
  const std::string_view to = destination(host);
  if (to.starts_with("127.") || to == "[::1]") return false;
  return host.starts_with('[') || host.find_first_not_of("0123456789.") == std::string_view::npos;
}

// The lowest port that systems give to outgoing connections (Linux; others begin higher).
constexpr std::uint16_t kFirstOutgoing = 32768;

bool leads_to(std::string_view link, const HostPort& wanted) {
  const auto end = host_and_port(link);
  if (!end) return false;
  if (!is_address(wanted.host)) return end->port == wanted.port;
  // Either side may have connected, so the remote port is the wanted one or an outgoing one. Links
  // to other programs of that host have other ports.
  return end->host == wanted.host && (end->port == wanted.port || end->port >= kFirstOutgoing);
}

/// Initiative of programs outside the chain: above all stages. Second instances are above it.
constexpr std::uint8_t kOutside = 16;

std::uint8_t initiative_of(std::optional<std::size_t> place, bool second_instance) {
  const auto& rows = stage_list();
  if (!place || !rows[*place].in_chain) return kOutside;
  const auto behind = static_cast<std::uint8_t>(rows.size() - *place);
  return second_instance ? kOutside + behind : behind;
}

/// Random, with the initiative at its end: Zenoh compares identifiers from the last two digits on.
std::string identifier(std::uint8_t initiative) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::random_device random;
  std::uniform_int_distribution<std::size_t> digit(1, kDigits.size() - 1);
  std::string id;
  while (id.size() < 30) id += kDigits[digit(random)];
  return id + kDigits[initiative >> 4] + kDigits[initiative & 15];
}

}  // namespace

std::string endpoints_error(const std::vector<std::string>& endpoints) {
  for (const std::string& endpoint : endpoints) {
    if (host_and_port(endpoint)) continue;
    return "'" + endpoint + "': tcp/HOST:PORT is expected, such as tcp/192.168.1.5:7447";
  }
  return {};
}

std::string host_error(const std::string& host) {
  const bool in_brackets = host.starts_with('[') && host.ends_with(']');
  const bool has_port =
      !in_brackets && (host.starts_with('[') || std::count(host.begin(), host.end(), ':') == 1);
  const bool is_host = !host.empty() && host.find_first_of(" \t\n\r/?#") == std::string::npos;
  if (is_host && !has_port) return {};
  return "'" + host +
         "': a name or an address is expected, without protocol and port, such as 192.168.1.5";
}

void check_endpoints(const ZenohConfig& config) {
  for (const auto& [key, endpoints] :
       {std::pair("zenoh.connect", config.connect), std::pair("zenoh.listen", config.listen)}) {
    const std::string error = endpoints_error(endpoints);
    if (!error.empty()) throw ConfigError(std::string(key) + ": " + error);
  }
}

Endpoints endpoints_of(const ZenohConfig& config, const std::string& stage) {
  check_endpoints(config);
  Endpoints e;
  const auto& rows = stage_list();
  const std::optional<std::size_t> own = stage_place(stage);
  const bool second_instance = config.base_port > 0 && !config.listen.empty();
  e.initiative = initiative_of(own, second_instance);
  for (std::size_t i = 0; config.base_port > 0 && i < rows.size(); ++i) {
    const std::string port = ":" + std::to_string(config.base_port + static_cast<int>(i));
    if (i == own && !second_instance) {
      e.listen.push_back("tcp/" + listen_address(config) + port);
    } else if (rows[i].in_chain && (i > own || e.initiative >= kOutside)) {
      e.connect.push_back("tcp/" + address_of(config, rows[i].name) + port);
    }
  }
  if (!config.listen.empty()) e.listen = config.listen;
  if (e.listen.empty()) e.listen = {"tcp/" + listen_address(config) + ":0"};
  e.connect.insert(e.connect.end(), config.connect.begin(), config.connect.end());
  return e;
}

std::vector<std::string> without_link(const std::vector<std::string>& endpoints,
                                      const std::vector<std::string>& links) {
  std::vector<std::string> found;
  std::vector<std::string> left = links;
  for (auto at = endpoints.begin(); at != endpoints.end(); ++at) {
    const auto wanted = host_and_port(*at);
    const bool was_named = std::find(endpoints.begin(), at, *at) != at;
    if (!wanted || was_named) continue;
    // Two routers may use the same port, so each link counts for one endpoint only.
    const auto link = std::find_if(left.begin(), left.end(),
                                   [&](const std::string& end) { return leads_to(end, *wanted); });
    if (link == left.end()) {
      found.push_back(*at);
    } else {
      left.erase(link);
    }
  }
  return found;
}

zenoh::Config session_config(const ZenohConfig& config, const Endpoints& endpoints) {
  zenoh::Config c = zenoh::Config::create_default();
  c.insert_json5("id", '"' + identifier(endpoints.initiative) + '"');
  c.insert_json5("mode", "\"peer\"");
  c.insert_json5("listen/endpoints", text(endpoints.listen));
  c.insert_json5("connect/endpoints", text(endpoints.connect));
  c.insert_json5("connect/exit_on_failure", "false");
  c.insert_json5("connect/timeout_ms", "-1");
  // The stages before a restarted one must connect to it at once: their messages wait for it.
  c.insert_json5("connect/retry",
                 "{period_init_ms: 100, period_max_ms: 100, period_increase_factor: 1}");
  c.insert_json5("scouting/multicast/enabled", "false");
  c.insert_json5("scouting/gossip/enabled", "true");
  c.insert_json5("scouting/gossip/autoconnect_strategy",
                 R"({peer: {to_router: "always", to_peer: "greater-zid"}})");
  c.insert_json5("timestamping/enabled", "true");
  c.insert_json5("transport/link/tx/lease", std::to_string(config.lease_ms));
  const std::string shm = "transport/shared_memory/";
  c.insert_json5(shm + "enabled", config.shared_memory ? "true" : "false");
  // Otherwise Zenoh creates a segment for its own bookkeeping even if "enabled" is false, and fails
  // if there is no room for it.
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
