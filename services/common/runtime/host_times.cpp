#include "common/runtime/host_times.hpp"

#include <chrono>
#include <fstream>
#include <utility>
#include <vector>

#include "common/messages/verify.hpp"
#include "common/runtime/log.hpp"
#include "common/runtime/shared.hpp"

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kAnswersWithin{900};
/// Latencies between hosts are not reported if the clocks' offset is known less well than this.
constexpr std::int64_t kTooUncertain_ns = 5 * kMs;
/// Maximum number of hosts that are asked for their time; messages of others get no latency.
constexpr std::size_t kMostHosts = 16;
constexpr std::int64_t kForgotten_ns = 60'000 * kMs;

/// Identifies the clock: the kernel's boot id, which all containers of one machine share. A clock
/// that is shifted by fault injection counts as another one.
std::string boot_id() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string id;
  file >> id;
  return clock_fault_ns() == 0 ? id : id + "+fault";
}

Buffer build_time(const std::string& host, const std::string& boot, std::int64_t received_ns) {
  flatbuffers::FlatBufferBuilder b;
  const auto host_text = b.CreateString(host);
  const auto boot_text = b.CreateString(boot);
  b.Finish(msg::CreateHostTime(b, host_text, boot_text, received_ns, wall_ns()),
           Kind<msg::HostTime>::kIdentifier);
  return b.Release();
}

/// The stage that received the packets: the first point of the trace; null if it has no valid name.
const msg::TracePoint* source_of(const msg::Header& header) {
  const auto* trace = header.trace();
  if (trace == nullptr || trace->size() == 0) return nullptr;
  const msg::TracePoint* point = trace->Get(0);
  const bool named = point->host() != nullptr && point->stage() != nullptr &&
                     point->instance() != nullptr &&
                     Keys::chunk_error(point->stage()->string_view()).empty() &&
                     Keys::chunk_error(point->instance()->string_view()).empty();
  return named ? point : nullptr;
}

}  // namespace

HostTimes::HostTimes(const Identity& identity, const Keys& keys, zenoh::Session& session)
    : host_(identity.host), boot_(boot_id()), keys_(keys), session_(session) {
  const std::string key = keys.time(identity.stage, identity.instance);
  queryable_ =
      session.declare_queryable(key, [key, host = host_, boot = boot_](zenoh::Query&& query) {
        const std::int64_t received_ns = wall_ns();
        query.reply(key, zenoh::Bytes::own(build_time(host, boot, received_ns)),
                    encoding_of(Key::kTime));
      });
}

void HostTimes::ask(std::int64_t now_ns) {
  std::vector<std::pair<std::string, std::string>> questions;
  {
    const std::lock_guard lock(known_->mutex);
    std::erase_if(known_->hosts, [now_ns](const auto& entry) {
      return now_ns - entry.second.named_ns > kForgotten_ns;
    });
    for (const auto& [host, other] : known_->hosts) {
      if (!other.same_clock) questions.emplace_back(host, keys_.time(other.stage, other.instance));
    }
  }
  for (const auto& [host, key] : questions) ask(host, key);
}

void HostTimes::ask(const std::string& host, const std::string& key) {
  zenoh::GetOptions options;
  options.timeout = kAnswersWithin;
  const std::int64_t asked_ns = wall_ns();
  const auto on_reply = [known = known_, host, boot = boot_, asked_ns](zenoh::Reply&& reply) {
    const std::int64_t answered_ns = wall_ns();
    if (!reply.ok()) return;
    const zenoh::AlignedBytes bytes = zenoh::view_aligned(std::move(reply.sample->payload));
    if (!verify<msg::HostTime>(bytes.data(), reply.sample->encoding).ok()) return;
    const auto& time = message_of<msg::HostTime>(bytes.data());
    const std::lock_guard lock(known->mutex);
    const auto found = known->hosts.find(host);
    if (found == known->hosts.end()) return;
    Other& other = found->second;
    other.same_clock = time.boot() != nullptr && time.boot()->string_view() == boot;
    other.clock.add({asked_ns, time.received_ns(), time.sent_ns(), answered_ns});
  };
  try {
    session_.get(
        key, on_reply, [] {}, options);
  } catch (const zenoh::ZenohError& e) {
    log(Level::kDebug, "a host was not asked for its time", {{"key", key}, {"what", e.what()}});
  }
}

std::optional<ClockOffset> HostTimes::offset_of(const msg::TracePoint& stage) {
  if (stage.host()->string_view() == host_) return ClockOffset{};
  const std::lock_guard lock(known_->mutex);
  const std::string host = stage.host()->str();
  if (known_->hosts.size() >= kMostHosts && !known_->hosts.contains(host)) {
    ++known_->not_asked;
    return std::nullopt;
  }
  Other& other = known_->hosts[host];
  other.named_ns = steady_ns();
  other.stage = stage.stage()->str();
  other.instance = stage.instance()->str();
  return other.same_clock ? ClockOffset{} : other.clock.offset();
}

std::optional<double> HostTimes::since_last_packet_ms(const msg::Header& header,
                                                      std::int64_t now_ns) {
  const msg::TracePoint* source = source_of(header);
  if (source == nullptr) return std::nullopt;
  const auto between = offset_of(*source);
  const bool known = between && between->uncertainty_ns <= kTooUncertain_ns;
  if (!known || header.last_packet_ns() <= 0) return std::nullopt;
  const std::int64_t packet_here_ns = header.last_packet_ns() - between->offset_ns;
  return 1e-6 * static_cast<double>(now_ns - packet_here_ns);
}

std::uint64_t HostTimes::not_asked() const {
  const std::lock_guard lock(known_->mutex);
  return known_->not_asked;
}

std::map<std::string, ClockOffset> HostTimes::offsets() const {
  const std::lock_guard lock(known_->mutex);
  std::map<std::string, ClockOffset> all;
  for (const auto& [host, other] : known_->hosts) {
    const auto found = other.clock.offset();
    if (found && !other.same_clock) all.emplace(host, *found);
  }
  return all;
}

}  // namespace zloam::runtime
