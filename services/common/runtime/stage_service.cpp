// A stage's reports about itself: health, status, configuration, token.

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>
#include <utility>

#include "common/runtime/log.hpp"
#include "common/runtime/run_id.hpp"
#include "common/runtime/session_config.hpp"
#include "common/runtime/stage_core.hpp"

namespace zloam::runtime {
namespace {

constexpr std::chrono::milliseconds kStatusPeriod{1000};
// A greater clock offset between hosts is reported as a fault (docs/protocol.md, section 10).
constexpr std::int64_t kClocksApart_ns = 50 * kMs;
// Names of the figures of a host's clock, before the host.
constexpr const char* kClockOffset = "clock_offset_ms/";
constexpr const char* kClockUncertainty = "clock_uncertainty_ms/";
// Statuses (one per second) without a drop until an overload counts as over.
constexpr int kLooksUntilCalm = 5;
// Statuses at which heap memory is returned to the system after an oversized message: copies that
// were still in use at the first of them are free by the last.
constexpr int kLooksAtHeap = 5;
constexpr std::int64_t kHandlerCalm_ns = 5000 * kMs;
// Statuses until an endpoint without a link is reported: at the start and after a break, Zenoh
// needs a moment to connect.
constexpr int kLooksUntilLinked = 5;
// First and greatest waiting time before a silent input is subscribed again; doubles in between.
constexpr std::int64_t kFirstAgain_ns = 2000 * kMs, kLastAgain_ns = 60000 * kMs;

}  // namespace

void StageCore::figure(const std::string& name, double value) {
  const std::lock_guard lock(mutex_);
  figures_[name] = value;
}

void StageCore::degraded(const std::string& topic, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  if (reason.empty()) {
    degraded_.erase(topic);
  } else {
    degraded_[topic] = reason;
  }
}

void StageCore::ready(bool yes, const std::string& reason) {
  const std::lock_guard lock(mutex_);
  own_ready_ = yes;
  own_reason_ = reason;
}

std::vector<Account> StageCore::accounts() const {
  const std::lock_guard lock(bell_->mutex);
  std::vector<Account> all;
  for (const auto& inlet : inlets_) all.push_back(inlet->account_locked());
  return all;
}

std::string StageCore::unmatched() const {
  const auto& stages = setup_.shared.flow.wait_for;
  for (const auto& outlet : outlets_) {
    for (const std::string& reader : readers_of(outlet->row())) {
      const bool deployed = std::find(stages.begin(), stages.end(), reader) != stages.end();
      if (deployed && !outlet->matching()) return outlet->key();
    }
  }
  return {};
}

ServiceHealth StageCore::health(std::string* reason) const {
  const std::string lonely = unmatched();
  const std::lock_guard lock(mutex_);
  const auto because = [reason](const std::string& text, ServiceHealth h) {
    *reason = text;
    return h;
  };
  if (!failure_.empty()) return because(failure_, ServiceHealth::kFailed);
  if (stopping_.load()) return because("stopping", ServiceHealth::kStopping);
  if (!declared_) return because(own_ready_ ? "starting" : own_reason_, ServiceHealth::kStarting);
  if (!own_ready_) return because(own_reason_, ServiceHealth::kStarting);
  if (!degraded_.empty()) {
    std::string all;
    for (const auto& [topic, why] : degraded_) {
      if (!all.empty()) all += "; ";
      all.append(topic).append(": ").append(why);
    }
    return because(all, ServiceHealth::kDegraded);
  }
  if (!lonely.empty()) {
    // Before the first sweep a subscriber may still be starting; after it, one was lost.
    return because("no subscriber on " + lonely,
                   has_sweep_ ? ServiceHealth::kDegraded : ServiceHealth::kStarting);
  }
  return because("", ServiceHealth::kReady);
}

StatusFields StageCore::status() const {
  StatusFields f;
  f.identity = setup_.identity;
  f.health = health(&f.reason);
  f.stamp_ns = wall_ns();
  f.started_ns = started_ns_;
  f.inputs = accounts();
  for (const auto& o : outlets_) {
    f.outputs.push_back({o->key(), o->published(), o->bytes(), o->republished()});
  }
  f.latencies = latencies_.summaries();
  f.usage = process_usage();
  f.rss_start_mib = rss_start_mib_;
  f.config_rev = live_->effective().rev;
  f.transfer = {bell_->transfer.bytes_in_place.load(), bell_->transfer.bytes_copied.load(),
                bell_->transfer.messages_shared_memory.load(),
                bell_->transfer.messages_other.load()};
  const std::lock_guard lock(mutex_);
  f.run = run_;
  f.last_sweep = last_sweep_;
  f.has_sweep = has_sweep_;
  f.end_of_run = run_ended_;
  note_source(&f);
  f.figures = figures_;
  f.figures["rss_anon_mib"] = f.usage.rss_anon_mib;
  f.figures["rss_shm_mib"] = f.usage.rss_shm_mib;
  if (singleton_) {
    f.figures["term"] = singleton_->term();
    f.figures["silent"] = *muted_ ? 1.0 : 0.0;
  }
  return f;
}

/// A source has no input of sweeps, so its output shows its progress.
void StageCore::note_source(StatusFields* f) const {
  const OutletCore* source = source_.load();
  if (source == nullptr) return;
  const auto last = source->last();
  if (!last) return;
  f->run = last->run;
  f->last_sweep = last->sweep;
  f->has_sweep = true;
  f->end_of_run = last->ended;
}

/// Reports another instance of this stage if no standby is configured.
void StageCore::watch_second() {
  if (!singleton_) return;
  // Standbys are meant to be there, but none of them silences the instance that works.
  const bool leaves = leaving_ || is_overtaken();
  const bool silenced = *muted_ && !leaves;
  const bool meant = setup_.shared.recovery.standby && !silenced;
  const std::string others = meant ? std::string() : singleton_->others();
  if (!others.empty() && others != said_of_others_) log_warning(others);
  if (others.empty() && !said_of_others_.empty()) log_info("the other instance has gone");
  said_of_others_ = others;
  degraded("another instance", others);
}

/// Withdraws the report of a handler's exception when no other followed for kHandlerCalm_ns.
void StageCore::watch_handlers() {
  const std::int64_t threw_ns = handler_threw_ns_.load();
  if (threw_ns == 0 || steady_ns() - threw_ns < kHandlerCalm_ns) return;
  handler_threw_ns_ = 0;
  degraded("handler", "");
}

/// Oversized messages arrive in many fragments, whose memory the allocator would keep.
void StageCore::watch_oversized() {
  std::uint64_t now = 0;
  {
    const std::lock_guard lock(bell_->mutex);
    now = bell_->oversized;
  }
  if (std::exchange(oversized_, now) != now) looks_at_heap_ = kLooksAtHeap;
  if (looks_at_heap_ == 0) return;
  give_back_heap();
  if (--looks_at_heap_ == 0) keep_heap();
}

void StageCore::declare_status() {
  const Identity& id = setup_.identity;
  const std::string status_key = keys_.status(id.stage, id.instance);
  zenoh::PublisherOptions options;
  options.priority = zenoh::Priority::kBackground;
  options.encoding = encoding_of(Key::kStatus);
  status_publisher_ = session_.declare_publisher(status_key, options);
  queryables_.push_back(session_.declare_queryable(status_key, [this,
                                                                status_key](zenoh::Query&& query) {
    query.reply(status_key, zenoh::Bytes::own(runtime::build(status())), encoding_of(Key::kStatus));
  }));
}

void StageCore::declare_service() {
  const Identity& id = setup_.identity;
  const std::string config_key = keys_.config(id.stage, id.instance);
  declare_status();
  queryables_.push_back(
      session_.declare_queryable(config_key, [this, config_key](zenoh::Query&& query) {
        const EffectiveValues now = live_->effective();
        query.reply(config_key,
                    zenoh::Bytes::own(build_config(setup_.identity, now.rev, now.values_json,
                                                   sha256_hex(now.result_json))),
                    encoding_of(Key::kConfig));
      }));
  host_times_.emplace(id, keys_, session_);
  {
    const std::lock_guard lock(mutex_);
    declared_ = true;
  }
  alive_ = session_.declare_liveliness_token(keys_.alive(id.stage, id.instance));
  status_thread_ = std::thread([this] { status_loop(); });
  log_info("started", {{"instance", id.instance}, {"robot", id.robot}, {"version", id.version}});
}

void StageCore::status_loop() {
  std::unique_lock lock(status_mutex_);
  while (!status_end_) {
    lock.unlock();
    watch_overload();
    watch_second();
    watch_overtaken();
    watch_handlers();
    watch_oversized();
    watch_inputs();
    watch_clocks();
    watch_links();
    publish_status();
    lock.lock();
    status_bell_.wait_for(lock, kStatusPeriod, [this] { return status_end_; });
  }
}

/// Reports an overload while sweeps are dropped for lack of time, and for a while after.
void StageCore::watch_overload() {
  std::uint64_t dropped = 0;
  for (const Account& account : accounts()) {
    dropped += account.dropped[static_cast<std::size_t>(Drop::kQueueFull)];
  }
  const std::uint64_t more = dropped - std::exchange(overload_dropped_, dropped);
  looks_without_drop_ = more > 0 ? 0 : looks_without_drop_ + 1;
  if (more > 0) {
    degraded("overload", std::to_string(more) +
                             " sweeps dropped in a second, as the queue was full: "
                             "there is not the time that the sensor's pace needs");
  } else if (looks_without_drop_ == kLooksUntilCalm) {
    degraded("overload", "");
  }
}

/// Expects regular inputs only in live runs: a replay waits for its slowest stage.
void StageCore::watch_inputs() {
  bool paced = false;
  {
    const std::lock_guard lock(mutex_);
    paced = in_run_ && !run_ended_ && !replay_;
  }
  std::vector<InputWatch::Input> inputs;
  {
    const std::lock_guard lock(bell_->mutex);
    for (const auto& inlet : inlets_) {
      inputs.push_back({inlet->account_locked(), inlet->unasked_locked(),
                        inlet->has_unread_locked(), paced && inlet->is_regular()});
    }
  }
  const auto found = input_watch_.look(inputs, steady_ns());
  for (const auto& [topic, reason] : found) degraded(topic, reason);
  subscribe_again(found);
}

// After a link was lost and restored (a process got no CPU time for longer than the lease),
// declarations of one side may be missing on it: the publisher then never sends here again, while
// all stages report ready (docs/protocol.md, section 11). Until this helps, the input is requested
// by number (Sequencer::request).
void StageCore::subscribe_again(const std::map<std::string, std::string>& silences) {
  const std::int64_t now = steady_ns();
  const std::lock_guard lock(subscriptions_mutex_);
  for (Subscription& subscription : subscriptions_) {
    const auto found = silences.find("silent " + subscription.inlet->key());
    const bool silent = found != silences.end() && !found->second.empty();
    if (!silent) subscription.wait_ns = 0;
    if (!silent || (subscription.wait_ns > 0 && now < subscription.again_ns)) continue;
    // At the beginning of a silence, only start the waiting time: it may be over soon.
    const bool begins = subscription.wait_ns == 0;
    subscription.wait_ns = std::clamp(2 * subscription.wait_ns, kFirstAgain_ns, kLastAgain_ns);
    subscription.again_ns = now + subscription.wait_ns;
    if (begins) continue;
    log_warning("nothing comes: subscribing again", {{"key", subscription.inlet->key()}});
    // On this thread an exception would end the process. The next attempt is at again_ns.
    try {
      subscribe(subscription);
    } catch (const zenoh::ZenohError& e) {
      log_error("could not subscribe again",
                {{"key", subscription.inlet->key()}, {"what", e.what()}});
    }
  }
}

void StageCore::watch_clocks() {
  host_times_->ask(steady_ns());
  if (const auto count = host_times_->not_asked(); count > 0) {
    figure("hosts_not_asked", static_cast<double>(count));
  }
  std::string apart;
  std::map<std::string, double> figures;
  for (const auto& [host, clock] : host_times_->offsets()) {
    const double offset_ms = 1e-6 * static_cast<double>(clock.offset_ns);
    figures[kClockOffset + host] = offset_ms;
    figures[kClockUncertainty + host] = 1e-6 * static_cast<double>(clock.uncertainty_ns);
    if (std::abs(clock.offset_ns) - clock.uncertainty_ns <= kClocksApart_ns) continue;
    const auto whole_ms = static_cast<long>(std::lround(std::abs(offset_ms)));
    apart = "the clock of " + host + " is " + std::to_string(whole_ms) + " ms " +
            (offset_ms > 0 ? "ahead of" : "behind") + " this host's: both need NTP or PTP";
  }
  degraded("clock", apart);
  const std::lock_guard lock(mutex_);
  // Also those of hosts that have gone.
  std::erase_if(figures_, [](const auto& entry) {
    return entry.first.starts_with(kClockOffset) || entry.first.starts_with(kClockUncertainty);
  });
  figures_.merge(figures);
}

/// Reports configured endpoints without a link, such as a router that has gone: the stages continue
/// without it, so nothing else shows the loss.
void StageCore::watch_links() {
  const auto& wanted = setup_.shared.zenoh.connect;
  const auto missing = without_link(wanted, wanted.empty() ? wanted : session_.links());
  looks_without_link_ = missing.empty() ? 0 : looks_without_link_ + 1;
  std::string text;
  for (const std::string& endpoint : missing) text += (text.empty() ? "" : ", ") + endpoint;
  if (looks_without_link_ == kLooksUntilLinked) log_warning("no link", {{"zenoh.connect", text}});
  if (looks_without_link_ >= kLooksUntilLinked) {
    text = "nothing answers at " + text +
           " (zenoh.connect): whoever is reached through it hears nothing of this stage; is it on, "
           "and does a firewall let its port through?";
  } else {
    text.clear();
  }
  degraded("links", text);
}

void StageCore::publish_status() {
  if (!status_publisher_) return;
  try {
    status_publisher_->put(zenoh::Bytes::own(runtime::build(status())));
  } catch (const std::exception& e) {
    log(Level::kDebug, "status not published", {{"what", e.what()}});
  }
}

}  // namespace zloam::runtime
