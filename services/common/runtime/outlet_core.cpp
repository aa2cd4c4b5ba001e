#include "common/runtime/outlet_core.hpp"

#include <algorithm>
#include <thread>

#include "common/runtime/whole_number.hpp"

namespace zloam::runtime {
namespace {

zenoh::Priority priority_of(std::string_view name) {
  if (name == "interactive_high") return zenoh::Priority::kInteractiveHigh;
  if (name == "interactive_low") return zenoh::Priority::kInteractiveLow;
  if (name == "data_high") return zenoh::Priority::kDataHigh;
  if (name == "data_low") return zenoh::Priority::kDataLow;
  if (name == "background") return zenoh::Priority::kBackground;
  return zenoh::Priority::kData;
}

struct Span {
  std::uint64_t first = 0, last = 0;
  bool holds(std::uint64_t n) const { return first <= n && n <= last; }
};

/// "a..b" or "a".
std::optional<Span> parse_span(std::string_view text) {
  const auto dots = text.find("..");
  const auto last = dots == std::string_view::npos ? text : text.substr(dots + 2);
  const auto from = whole_number<std::uint64_t>(text.substr(0, dots));
  const auto to = whole_number<std::uint64_t>(last);
  if (!from || !to) return std::nullopt;
  return Span{*from, *to};
}

/// Value of "name=" in "a=1;b=2".
std::optional<std::string_view> parameter(std::string_view parameters, std::string_view name) {
  while (!parameters.empty()) {
    const auto end = parameters.find(';');
    const std::string_view item = parameters.substr(0, end);
    const auto equals = item.find('=');
    if (equals != std::string_view::npos && item.substr(0, equals) == name) {
      return item.substr(equals + 1);
    }
    if (end == std::string_view::npos) break;
    parameters.remove_prefix(end + 1);
  }
  return std::nullopt;
}

}  // namespace

void MessageCache::put(Entry entry) {
  const std::lock_guard lock(mutex_);
  held_bytes_ += entry.payload.size();
  entries_.push_back(std::move(entry));
  while (entries_.size() > messages_ || (held_bytes_ > bytes_ && entries_.size() > 1)) {
    held_bytes_ -= entries_.front().payload.size();
    entries_.pop_front();
  }
}

std::optional<MessageCache::Entry> MessageCache::find(std::uint64_t run,
                                                      std::uint64_t sweep) const {
  const std::lock_guard lock(mutex_);
  const auto found = std::find_if(entries_.rbegin(), entries_.rend(),
                                  [&](const Entry& e) { return e.run == run && e.sweep == sweep; });
  return found == entries_.rend() ? std::nullopt : std::optional<Entry>(*found);
}

std::vector<MessageCache::Entry> MessageCache::select(std::string_view parameters) const {
  std::vector<Entry> found;
  const auto run_text = parameter(parameters, "run");
  const auto run = run_text ? whole_number<std::uint64_t>(*run_text) : std::nullopt;
  if (run_text && !run) return found;
  const auto sweep_text = parameter(parameters, "sweep");
  const auto seq_text = parameter(parameters, "seq");
  const auto span = sweep_text ? parse_span(*sweep_text)
                    : seq_text ? parse_span(*seq_text)
                               : std::optional<Span>(std::nullopt);
  if (!span) return found;
  {
    const std::lock_guard lock(mutex_);
    for (const Entry& e : entries_) {
      if (run && e.run != *run) continue;
      if (span->holds(sweep_text ? e.sweep : e.seq)) found.push_back(e);
    }
  }
  std::stable_sort(found.begin(), found.end(), [](const Entry& a, const Entry& b) {
    return std::pair(a.sweep, a.seq) < std::pair(b.sweep, b.seq);
  });
  return found;
}

std::vector<MessageCache::Entry> MessageCache::all() const {
  const std::lock_guard lock(mutex_);
  return {entries_.begin(), entries_.end()};
}

std::size_t MessageCache::size() const {
  const std::lock_guard lock(mutex_);
  return entries_.size();
}

OutletCore::OutletCore(OutletSetup setup, zenoh::Session& session)
    : setup_(std::move(setup)),
      session_(session),
      encoding_(encoding_of(setup_.row)),
      cache_(setup_.keep_messages, setup_.keep_bytes) {
  live_ = session_.declare_publisher(setup_.key, options(false));
  if (key_row(setup_.row).numbering == Numbering::kNone) return;
  // Declared as not complete: a standby or a consumer may hold messages that this publisher lacks.
  queryable_ = session_.declare_queryable(
      setup_.key, [this](zenoh::Query&& query) { answer(std::move(query)); }, false);
}

zenoh::PublisherOptions OutletCore::options(bool block) const {
  const KeyRow& row = key_row(setup_.row);
  zenoh::PublisherOptions o;
  o.congestion_control = block ? zenoh::CongestionControl::kBlock : zenoh::CongestionControl::kDrop;
  o.priority = priority_of(row.priority);
  // Small, urgent messages do not wait for a batch.
  o.express = o.priority == zenoh::Priority::kInteractiveHigh;
  o.encoding = encoding_;
  return o;
}

bool OutletCore::matching() const { return live_->matching(); }

HeaderFields OutletCore::header(std::int64_t received_ns, std::int64_t started_ns) {
  HeaderFields h;
  h.robot = setup_.robot;
  h.sensor = setup_.sensor;
  h.seq = seq_;
  h.instance = setup_.instance;
  if (setup_.term) h.term = setup_.term();
  h.trace.push_back(
      {setup_.stage, setup_.host, setup_.instance, received_ns, started_ns, wall_ns()});
  return h;
}

HeaderFields OutletCore::header(const Message& cause) {
  HeaderFields h = header_fields(*cause.header);
  h.seq = seq_;
  h.instance = setup_.instance;
  if (setup_.term) h.term = setup_.term();
  if (setup_.config_rev) h.config_rev = setup_.config_rev(h.run, h.sweep);
  h.trace.push_back(
      {setup_.stage, setup_.host, setup_.instance, cause.received_ns, cause.started_ns, wall_ns()});
  return h;
}

void OutletCore::put(const zenoh::Bytes& payload, bool replay) {
  const bool block = replay && key_row(setup_.row).congestion == Congestion::kLiveDrop;
  if (block && !replay_) replay_ = session_.declare_publisher(setup_.key, options(true));
  (block ? *replay_ : *live_).put(payload);
  // The put woke the transport's thread on this processor. Unless this thread yields, the other may
  // wait for it for milliseconds, even while another processor is idle.
  if (!block) std::this_thread::yield();
}

void OutletCore::publish(const HeaderFields& header, Buffer message) {
  if (*setup_.muted) return;
  const std::size_t size = message.size();
  const zenoh::Bytes payload = zenoh::Bytes::own(std::move(message));
  ++seq_;
  {
    const std::lock_guard lock(last_mutex_);
    last_ = {header.run, header.sweep, header.end_of_run};
  }
  // Cache the message before sending it, so that a receiver that misses it can get it at once.
  if (queryable_) cache_.put({header.run, header.sweep, header.seq, payload, header.replay});
  put(payload, header.replay);
  published_.fetch_add(1);
  bytes_.fetch_add(size);
}

std::optional<OutletCore::Published> OutletCore::last() const {
  const std::lock_guard lock(last_mutex_);
  return last_;
}

void OutletCore::publish_at(const std::string& key, const HeaderFields& header, Buffer message) {
  if (*setup_.muted) return;
  const std::size_t size = message.size();
  ++seq_;
  session_.put(key, zenoh::Bytes::own(std::move(message)),
               options(header.replay && key_row(setup_.row).congestion == Congestion::kLiveDrop));
  published_.fetch_add(1);
  bytes_.fetch_add(size);
}

bool OutletCore::publish_again(std::uint64_t run, std::uint64_t sweep) {
  if (*setup_.muted) return false;
  const auto entry = cache_.find(run, sweep);
  if (!entry) return false;
  // Send it through the socket, like answers: a receiver that can't read the publisher's shared
  // memory (no room to lock it, a chunk taken back under load) would miss the second copy, too.
  put(entry->payload.in_parts(setup_.unshared_part), entry->replay);
  republished_.fetch_add(1);
  return true;
}

void OutletCore::answer(zenoh::Query&& query) {
  if (*setup_.muted && !answers_in_silence_) return;
  for (const auto& entry : cache_.select(query.parameters())) {
    query.reply(setup_.key, entry.payload, encoding_);
    republished_.fetch_add(1);
  }
}

}  // namespace zloam::runtime
