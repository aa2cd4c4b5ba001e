#include "common/runtime/flow_core.hpp"

#include <algorithm>
#include <limits>

#include "common/runtime/log.hpp"
#include "common/runtime/read.hpp"
#include "common/runtime/run_id.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kRetry_ns = 100 * kMs;
constexpr std::int64_t kWord_ns = 2000 * kMs;
constexpr std::int64_t kMaxAgain_ns = 10'000 * kMs;
constexpr std::chrono::milliseconds kGetTimeout{1000};

zenoh::PublisherOptions ack_options(const std::string& encoding) {
  zenoh::PublisherOptions o;
  o.congestion_control = zenoh::CongestionControl::kDrop;
  o.priority = zenoh::Priority::kInteractiveHigh;
  o.express = true;
  o.encoding = encoding;
  return o;
}

}  // namespace

FlowAckCore::FlowAckCore(const Keys& keys, std::string sink, std::string instance,
                         zenoh::Session& session, std::shared_ptr<const std::atomic<bool>> muted)
    : sink_(std::move(sink)),
      instance_(std::move(instance)),
      key_(keys.flow_ack(sink_)),
      encoding_(encoding_of(Key::kFlowAck)),
      muted_(std::move(muted)),
      publisher_(session.declare_publisher(key_, ack_options(encoding_))) {
  queryable_ = session.declare_queryable(
      key_,
      [this](zenoh::Query&& query) {
        const std::lock_guard lock(mutex_);
        if (any_ && !*muted_) query.reply(key_, zenoh::Bytes::own(message()), encoding_);
      },
      false);
}

Buffer FlowAckCore::message() {
  return build(FlowAckFields{run_, sink_, instance_, done_below_, seq_});
}

void FlowAckCore::publish() {
  if (*muted_) return;
  const zenoh::Bytes payload = zenoh::Bytes::own(message());
  ++seq_;
  publisher_.put(payload);
}

void FlowAckCore::done_below(std::uint64_t run, std::uint64_t sweep) {
  const std::lock_guard lock(mutex_);
  if (any_ && run == run_ && sweep <= done_below_) return;
  any_ = true;
  run_ = run;
  done_below_ = sweep;
  publish();
}

void FlowAckCore::waits(std::uint64_t run) {
  const std::lock_guard lock(mutex_);
  if (!any_ || run != run_) done_below_ = 0;
  any_ = true;
  run_ = run;
  publish();
}

void FlowAckCore::publish_again(std::uint64_t run) {
  const std::lock_guard lock(mutex_);
  if (any_ && run == run_) publish();
}

FlowWindowCore::FlowWindowCore(FlowWindowSetup setup, const Keys& keys, OutletCore& sweeps,
                               zenoh::Session& session, std::shared_ptr<Shared> shared,
                               std::function<void(const std::string&)> fail)
    : setup_(std::move(setup)),
      keys_(keys),
      sweeps_(sweeps),
      session_(session),
      shared_(std::move(shared)),
      fail_(std::move(fail)) {
  for (const std::string& sink : setup_.flow.sinks) {
    subscribers_.push_back(session_.declare_subscriber(
        keys_.flow_ack(sink), [this](zenoh::Sample&& sample) { on_ack(sample); }));
  }
}

void FlowWindowCore::on_ack(const zenoh::Sample& sample) {
  const Read<msg::FlowAck> ack(Key::kFlowAck, sample);
  if (!ack) return;
  {
    const std::lock_guard lock(mutex_);
    const auto& sinks = setup_.flow.sinks;
    if (std::find(sinks.begin(), sinks.end(), ack->sink()->string_view()) == sinks.end()) return;
    // An acknowledgement of another run would overwrite the sink's progress in this one.
    if (asked_ && ack->run() != run_) return;
    // No sink can have finished a sweep that was not published.
    const auto last = sweeps_.last();
    if (asked_ && last && ack->done_below() > last->sweep + 1) return;
    auto& [run, done] = acks_[ack->sink()->str()];
    // Within a run the greatest number counts, because acknowledgements may overtake one another.
    done = run == ack->run() ? std::max(done, ack->done_below()) : ack->done_below();
    run = ack->run();
  }
  shared_->notify();
}

void FlowWindowCore::start_live() {
  replay_ = false;
  set_run(static_cast<std::uint64_t>(wall_ns()));
  phase_ = Phase::kOpen;
}

void FlowWindowCore::set_run(std::uint64_t run) {
  {
    const std::lock_guard lock(mutex_);
    run_ = run;
    asked_ = true;
  }
  declare_run();
}

void FlowWindowCore::declare_run() {
  if (*setup_.muted) {
    run_token_.reset();
  } else if (run_ != 0 && !run_token_) {
    run_token_ =
        session_.declare_liveliness_token(keys_.run(setup_.own_instance, std::to_string(run_)));
  }
}

void FlowWindowCore::start_replay(const std::string& capture_hash) {
  replay_ = true;
  capture_hash_ = capture_hash;
  phase_ = Phase::kStages;
  next_word_ = steady_ns() + kWord_ns;
  shared_->notify();
}

std::uint64_t FlowWindowCore::done_below() const {
  const std::lock_guard lock(mutex_);
  std::uint64_t lowest = std::numeric_limits<std::uint64_t>::max();
  for (const std::string& sink : setup_.flow.sinks) {
    const auto ack = acks_.find(sink);
    const bool known = ack != acks_.end() && ack->second.first == run_;
    lowest = std::min(lowest, known ? ack->second.second : 0);
  }
  return lowest;
}

bool FlowWindowCore::may_send(std::uint64_t sweep) const {
  if (phase_ != Phase::kOpen) return false;
  if (!replay_) return true;
  const std::uint64_t done = done_below();
  return sweep < done || sweep - done < static_cast<std::uint64_t>(setup_.flow.window);
}

bool FlowWindowCore::finished() const {
  const auto last = sweeps_.last();
  if (!last || !last->ended) return false;
  return !replay_ || done_below() > last->sweep;
}

std::optional<std::int64_t> FlowWindowCore::deadline() const {
  if (phase_ == Phase::kIdle || (phase_ == Phase::kOpen && !replay_)) return std::nullopt;
  return steady_ns() + 50 * kMs;
}

void FlowWindowCore::tick() {
  declare_run();
  const std::int64_t now = steady_ns();
  switch (phase_) {
    case Phase::kIdle:
      return;
    case Phase::kStages:
      return tick_stages(now);
    case Phase::kConfigs:
      return tick_configs(now);
    case Phase::kAcks:
      return tick_acks(now);
    case Phase::kOpen:
      return tick_open(now);
  }
}

std::map<std::string, std::string> FlowWindowCore::missing_stages(
    const std::vector<zenoh::Sample>& samples) {
  std::map<std::string, std::string> missing;
  for (const std::string& stage : setup_.flow.wait_for) missing[stage] = "not there";
  std::map<std::string, bool> ready;
  for (const zenoh::Sample& sample : samples) {
    const Read<msg::Status> status(Key::kStatus, sample);
    if (!status) continue;
    const std::string stage = status->stage()->str();
    const bool fit = status->health() == msg::ServiceHealth::Ready ||
                     status->health() == msg::ServiceHealth::Degraded;
    ready[stage] = ready[stage] || fit;
    const auto entry = missing.find(stage);
    if (entry != missing.end() && status->reason() != nullptr) {
      entry->second = status->reason()->str();
    }
  }
  for (const auto& [stage, fit] : ready) {
    if (fit) missing.erase(stage);
  }
  if (!setup_.flow.wait_for.empty() && !sweeps_.matching()) {
    missing["(subscriber)"] = "no subscriber on " + sweeps_.key();
  }
  return missing;
}

void FlowWindowCore::say_what_is_missing(std::int64_t now,
                                         const std::map<std::string, std::string>& missing) {
  if (now < next_word_) return;
  next_word_ = now + kWord_ns;
  std::string text;
  for (const auto& [stage, why] : missing) {
    text.append(text.empty() ? "" : "; ").append(stage).append(": ").append(why);
  }
  log_info("waiting before the first sweep", {{"for", text}});
}

void FlowWindowCore::tick_stages(std::int64_t now) {
  if (auto samples = get_.take()) {
    next_try_ = now + kRetry_ns;
    const auto missing = missing_stages(*samples);
    if (missing.empty()) {
      phase_ = Phase::kConfigs;
      return;
    }
    say_what_is_missing(now, missing);
  }
  if (!get_.started() && now >= next_try_) {
    get_.start(session_, keys_.status("*", "*"), kGetTimeout, shared_);
  }
}

void FlowWindowCore::tick_configs(std::int64_t now) {
  if (auto samples = get_.take()) {
    next_try_ = now + kRetry_ns;
    std::map<std::string, std::string> hashes = {{setup_.own_stage, setup_.own_result_hash}};
    for (const zenoh::Sample& sample : *samples) {
      const Read<msg::EffectiveConfig> config(Key::kConfig, sample);
      if (!config) continue;
      const std::string stage = config->stage()->str();
      const std::string hash = config->result_hash()->str();
      const auto& wanted = setup_.flow.wait_for;
      if (std::find(wanted.begin(), wanted.end(), stage) == wanted.end()) continue;
      const auto [entry, is_new] = hashes.try_emplace(stage, hash);
      if (!is_new && entry->second != hash) {
        fail_("instances of " + stage + " run with different configurations");
        return;
      }
    }
    if (std::all_of(setup_.flow.wait_for.begin(), setup_.flow.wait_for.end(),
                    [&](const std::string& stage) { return hashes.contains(stage); })) {
      set_run(replay_run_id(capture_hash_, hashes));
      phase_ = Phase::kAcks;
      return;
    }
  }
  if (!get_.started() && now >= next_try_) {
    get_.start(session_, keys_.config("*", "*"), kGetTimeout, shared_);
  }
}

void FlowWindowCore::tick_acks(std::int64_t now) {
  if (setup_.flow.sinks.empty()) {
    phase_ = Phase::kOpen;
    return;
  }
  if (auto samples = get_.take()) {
    for (const zenoh::Sample& sample : *samples) on_ack(sample);
    resume_at_ = last_done_ = done_below();
    progress_at_ = now;
    again_wait_ns_ = setup_.flow.retransmit_ms * kMs;
    again_at_ = now + again_wait_ns_;
    phase_ = Phase::kOpen;
    log_info("the run begins", {{"run", run_}, {"first", resume_at_}});
    return;
  }
  if (!get_.started()) get_.start(session_, keys_.flow_ack("*"), kGetTimeout, shared_);
}

std::string FlowWindowCore::lagging_sinks() const {
  const std::uint64_t done = done_below();
  const std::lock_guard lock(mutex_);
  std::string text;
  for (const std::string& sink : setup_.flow.sinks) {
    const auto ack = acks_.find(sink);
    const bool behind =
        ack == acks_.end() || ack->second.first != run_ || ack->second.second == done;
    if (behind) text += (text.empty() ? "" : ", ") + sink;
  }
  return text;
}

void FlowWindowCore::tick_open(std::int64_t now) {
  if (!replay_ || setup_.flow.sinks.empty()) return;
  const std::uint64_t done = done_below();
  const auto last = sweeps_.last();
  if (done != last_done_ || !last || done > last->sweep) {
    // There was progress, or no sweep is in flight.
    last_done_ = done;
    progress_at_ = now;
    again_wait_ns_ = setup_.flow.retransmit_ms * kMs;
    again_at_ = now + again_wait_ns_;
    return;
  }
  if (now - progress_at_ > setup_.limit_ns) {
    fail_("sweep " + std::to_string(done) + " was not finished by " + lagging_sinks());
    return;
  }
  if (now < again_at_) return;
  again_wait_ns_ = std::min(again_wait_ns_ * 2, kMaxAgain_ns);
  again_at_ = now + again_wait_ns_;
  const bool sent = sweeps_.publish_again(run_, done);
  // If all sweeps in flight were lost, their receiver notices no gap until the newest one arrives.
  if (last->sweep > done) sweeps_.publish_again(run_, last->sweep);
  log(Level::kDebug, sent ? "published again" : "a sweep without progress is not kept any more",
      {{"sweep", done}, {"waiting_for", lagging_sinks()}});
}

}  // namespace zloam::runtime
