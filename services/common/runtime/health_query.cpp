#include "common/runtime/health_query.hpp"

#include <nlohmann/json.hpp>

#include "common/runtime/session_config.hpp"
#include "common/runtime/shared.hpp"
#include "common/runtime/status.hpp"
#include "common/zenoh/aligned.hpp"

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kDeadline{2000};
// Statuses older than this come from a router's storage, which still answers for ended processes.
constexpr std::int64_t kStale_ns = 5'000'000'000;

/// The endpoint at which a listener on all interfaces is reached from its own host.
std::string reachable(std::string endpoint) {
  for (const std::string_view any : {"/0.0.0.0:", "/[::]:"}) {
    if (const auto at = endpoint.find(any); at != std::string::npos) {
      endpoint.replace(at, any.size(), "/127.0.0.1:");
    }
  }
  return endpoint;
}

zenoh::Config client_config(const ZenohConfig& config, const std::vector<std::string>& listen) {
  Endpoints endpoints;
  for (const std::string& endpoint : listen) endpoints.connect.push_back(reachable(endpoint));
  zenoh::Config c = session_config(config, endpoints);
  c.insert_json5("mode", "\"client\"");
  c.insert_json5("listen/endpoints", "[]");
  c.insert_json5("connect/exit_on_failure", "true");
  c.insert_json5("connect/timeout_ms", std::to_string(kDeadline.count()));
  // A single query needs no shared-memory pool.
  c.insert_json5("transport/shared_memory/enabled", "false");
  return c;
}

HealthAnswer answer_of(const msg::Status& status) {
  const bool stands_by = status.reason() != nullptr && status.reason()->str() == kStandingBy;
  const bool well = status.health() == msg::ServiceHealth::Ready ||
                    status.health() == msg::ServiceHealth::Degraded || stands_by;
  std::string text = msg::EnumNameServiceHealth(status.health());
  if (status.reason() != nullptr && status.reason()->size() > 0) {
    text += ": " + status.reason()->str();
  }
  return {true, well, text};
}

HealthAnswer ask(const SharedConfig& shared, const std::string& stage, const std::string& host,
                 const std::string& instance) {
  const Endpoints endpoints = endpoints_of(shared.zenoh, stage);
  zenoh::Session session = zenoh::Session::open(client_config(shared.zenoh, endpoints.listen));
  const Keys keys(shared.robot, shared.sensor.name);
  zenoh::GetOptions options;
  options.timeout = kDeadline;
  HealthAnswer answer{false, false, "no answer from " + stage + " on this host"};
  for (zenoh::Reply& reply :
       session.get(keys.status(stage, instance.empty() ? "*" : instance), options)) {
    if (!reply.ok()) continue;
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(std::move(reply.sample->payload));
    if (!verify<msg::Status>(bytes.data(), reply.sample->encoding).ok()) continue;
    const auto& status = message_of<msg::Status>(bytes.data());
    const bool here = status.host() != nullptr && status.host()->str() == host;
    if (here && wall_ns() - status.stamp_ns() < kStale_ns) answer = answer_of(status);
  }
  session.close();
  return answer;
}

}  // namespace

HealthAnswer ask_health(const SharedConfig& shared, const std::string& stage,
                        const std::string& host, const std::string& instance) {
  try {
    return ask(shared, stage, host, instance);
  } catch (const std::exception& e) {
    return {false, false, e.what()};
  }
}

}  // namespace zloam::runtime
