#include "common/runtime/stage_core.hpp"

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

#include "common/runtime/log.hpp"
#include "common/runtime/run_id.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kTurn_ns = 20 * kMs;
constexpr std::int64_t kIdle_ns = 1000 * kMs;
constexpr std::chrono::milliseconds kStatusPeriod{1000};
constexpr std::size_t kPastRuns = 64;
constexpr std::size_t kOutputMemory = 256;

/// Which stage reads a key inside the robot: readiness waits for it when it is part of the
/// deployment.
struct Reader {
  Key key;
  const char* stage;
};
constexpr std::array kReaders = {
    Reader{Key::kSweep, "registration"},        Reader{Key::kFeatures, "odometry"},
    Reader{Key::kOdometry, "integration"},      Reader{Key::kOdometryFeatures, "mapping"},
    Reader{Key::kMapCorrection, "integration"},
};

SequencerLimits limits_of(const RecoveryConfig& c, const InletOptions& options) {
  SequencerLimits l;
  l.sweeps = options.sweeps;
  l.gap_live_ns = c.gap_live_ms * kMs;
  l.gap_replay_ns = c.gap_replay_ms * kMs;
  l.late_ns = c.late_ms * kMs;
  l.replay_limit_ns = c.replay_limit_s * 1000 * kMs;
  l.newest = options.newest > 0 ? options.newest : static_cast<std::size_t>(c.queue_sweeps);
  if (options.lossless) l.newest = 0;
  return l;
}

class QueryAnswer final : public Answer {
 public:
  explicit QueryAnswer(zenoh::Query& query) : query_(query) {}
  const std::string& key() const override { return query_.key(); }
  const std::string& parameters() const override { return query_.parameters(); }
  void reply(const std::string& key, const std::string& encoding, Buffer message) override {
    query_.reply(key, zenoh::Bytes::own(std::move(message)), encoding);
  }
  void refuse(const std::string& reason) override {
    query_.reply_error(zenoh::Bytes::copy_of(reason));
  }

 private:
  zenoh::Query& query_;
};

/// The arguments of a command: a Command message, or bare JSON text (from REST or a shell).
std::string arguments_of(const zenoh::Query& query) {
  const zenoh::AlignedBytes bytes = zenoh::view_aligned(query.payload());
  if (verify<msg::Command>(bytes.data(), encoding_of(Key::kCommand)).ok()) {
    const auto* text = message_of<msg::Command>(bytes.data()).arguments_json();
    return text == nullptr ? "{}" : text->str();
  }
  const std::string text = query.payload().to_string();
  return text.empty() ? "{}" : text;
}

CommandReply call(const CommandHandler& handler, const std::string& arguments) {
  if (!nlohmann::json::accept(arguments)) return {false, "the arguments are not JSON"};
  try {
    return handler(arguments);
  } catch (const std::exception& e) {
    return {false, e.what()};
  }
}

}  // namespace

StageCore::StageCore(StageSetup setup, zenoh::Session& session)
    : setup_(std::move(setup)),
      keys_(setup_.identity.robot, setup_.identity.sensor),
      session_(session) {
  if (setup_.fault_every > 0) {
    log_warning("FAULT INJECTION: received messages are thrown away on purpose",
                {{"every", setup_.fault_every}});
  }
}

StageCore::~StageCore() { close(); }

Outlet& StageCore::outlet(Key key) { return outlet_at(key, keys_.of(key)); }

Outlet& StageCore::outlet_at(Key key, const std::string& full_key) {
  OutletSetup s;
  s.row = key;
  s.key = full_key;
  s.robot = setup_.identity.robot;
  s.sensor = setup_.identity.sensor;
  s.stage = setup_.identity.stage;
  s.instance = setup_.identity.instance;
  s.host = setup_.identity.host;
  s.keep_messages = static_cast<std::size_t>(setup_.shared.recovery.keep_messages);
  s.keep_bytes = static_cast<std::size_t>(setup_.shared.recovery.keep_mib) << 20;
  outlets_.push_back(std::make_unique<OutletCore>(std::move(s), session_));
  return *outlets_.back();
}

Inlet& StageCore::add_inlet(Key, const std::string& full_key, const InletOptions& options,
                            VerifyFunction verify, HeaderFunction header,
                            std::function<Outcome(const Message&)> handler) {
  InletSetup s;
  s.key = full_key;
  s.options = options;
  s.limits = limits_of(setup_.shared.recovery, options);
  s.queue_bytes = static_cast<std::size_t>(setup_.shared.recovery.queue_mib) << 20;
  s.verify = verify;
  s.header = header;
  s.handler = std::move(handler);
  s.fault_every = setup_.fault_every;
  InletEvents& events = *this;
  const auto inlet = std::make_shared<InletCore>(std::move(s), bell_, events);
  {
    const std::lock_guard lock(bell_->mutex);
    inlets_.push_back(inlet);
  }
  subscribers_.push_back(session_.declare_subscriber(
      full_key, [inlet](zenoh::Sample&& sample) { inlet->on_sample(std::move(sample), false); }));
  return *inlet;
}

FlowWindow& StageCore::flow_window(Outlet& sweeps) {
  FlowWindowSetup s;
  s.own_stage = setup_.identity.stage;
  s.own_result_hash = sha256_hex(setup_.result_json);
  s.flow = setup_.shared.flow;
  s.limit_ns = setup_.shared.recovery.replay_limit_s * 1000 * kMs;
  auto& outlet = dynamic_cast<OutletCore&>(sweeps);
  window_ = std::make_unique<FlowWindowCore>(std::move(s), keys_, outlet, session_, bell_,
                                             [this](const std::string& r) { fail(r); });
  source_ = &outlet;
  return *window_;
}

FlowAck& StageCore::flow_ack(const std::string& sink) {
  acks_.push_back(std::make_unique<FlowAckCore>(keys_, sink, setup_.identity.instance, session_));
  return *acks_.back();
}

void StageCore::command(const std::string& verb, const std::string& doc, CommandHandler handler) {
  commands_[verb] = {doc, handler};
  queryables_.push_back(session_.declare_queryable(
      keys_.command(setup_.identity.stage, verb), [this, verb, handler](zenoh::Query&& query) {
        const auto shared_query = std::make_shared<zenoh::Query>(std::move(query));
        post([this, verb, handler, shared_query] {
          const CommandReply reply = call(handler, arguments_of(*shared_query));
          log_info("command", {{"verb", verb}, {"ok", reply.ok}, {"message", reply.message}});
          shared_query->reply(keys_.command(setup_.identity.stage, verb),
                              zenoh::Bytes::own(zloam::build(reply)), encoding_of(Key::kCommand));
        });
      }));
}

void StageCore::answer(const std::string& full_key, std::function<void(Answer&)> handler) {
  queryables_.push_back(session_.declare_queryable(full_key, [this, handler](zenoh::Query&& query) {
    const auto shared_query = std::make_shared<zenoh::Query>(std::move(query));
    post([handler, shared_query] {
      QueryAnswer answer(*shared_query);
      try {
        handler(answer);
      } catch (const std::exception& e) {
        answer.refuse(e.what());
      }
    });
  }));
}

void StageCore::every(std::chrono::milliseconds period, std::function<void()> task) {
  const std::int64_t period_ns = period.count() * kMs;
  timers_.push_back({period_ns, steady_ns() + period_ns, std::move(task)});
}

void StageCore::on_end_of_run(std::function<void(std::uint64_t)> task) {
  on_end_of_run_.push_back(std::move(task));
}

void StageCore::on_new_run(std::function<void(const msg::Header&)> task) {
  on_new_run_.push_back(std::move(task));
}

bool StageCore::before_message(const Message& message) {
  const std::uint64_t run = message.header->run();
  if (in_run_ && run == run_) return true;
  if (std::find(past_runs_.begin(), past_runs_.end(), run) != past_runs_.end()) return false;
  if (in_run_) past_runs_.push_back(run_);
  if (past_runs_.size() > kPastRuns) past_runs_.pop_front();
  {
    const std::lock_guard lock(mutex_);
    in_run_ = true;
    run_ = run;
    has_sweep_ = run_ended_ = false;
  }
  output_at_.clear();
  log_info("new run", {{"run", run}, {"replay", message.header->replay()}});
  for (const auto& task : on_new_run_) task(*message.header);
  return true;
}

void StageCore::after_message(const Message& message, bool ends_run) {
  const msg::Header& header = *message.header;
  const std::int64_t now = wall_ns();
  latencies_.add("queue", static_cast<double>(message.started_ns - message.received_ns) * 1e-6);
  latencies_.add("work", static_cast<double>(now - message.started_ns) * 1e-6);
  if (header.last_packet_ns() > 0) {
    latencies_.add("since_last_packet", static_cast<double>(now - header.last_packet_ns()) * 1e-6);
  }
  {
    const std::lock_guard lock(mutex_);
    last_sweep_ = has_sweep_ ? std::max(last_sweep_, header.sweep()) : header.sweep();
    has_sweep_ = true;
  }
  if (header.replay()) note_output(header.sweep());
  if (ends_run && header.end_of_run()) end_of_run(header.run());
}

void StageCore::end_of_run(std::uint64_t run) {
  {
    const std::lock_guard lock(mutex_);
    if (run_ended_ && run == run_) return;
    run_ = run;
    run_ended_ = true;
  }
  log_info("end of run", {{"run", run}});
  for (const auto& task : on_end_of_run_) task(run);
  publish_status();
}

void StageCore::second_copy(std::uint64_t run, std::uint64_t sweep) {
  if (!note_output(sweep)) return;
  for (const auto& outlet : outlets_) {
    if (key_row(outlet->row()).numbering == Numbering::kSweep) outlet->publish_again(run, sweep);
  }
  for (const auto& ack : acks_) ack->publish_again(run);
}

bool StageCore::note_output(std::uint64_t sweep) {
  const std::int64_t now = steady_ns();
  const std::int64_t quiet_ns = setup_.shared.flow.retransmit_ms * kMs / 2;
  const auto [entry, is_new] = output_at_.try_emplace(sweep, now);
  if (!is_new && now - entry->second < quiet_ns) return false;
  entry->second = now;
  if (output_at_.size() > kOutputMemory) output_at_.erase(output_at_.begin());
  return true;
}

void StageCore::overdue(const std::string& key, std::uint64_t sweep) {
  fail("sweep " + std::to_string(sweep) + " of " + key + " never came");
}

void StageCore::handler_threw(const std::string& key, std::uint64_t sweep,
                              const std::string& what) {
  log_error("a sweep could not be handled", {{"key", key}, {"sweep", sweep}, {"what", what}});
  degraded("handler", "sweep " + std::to_string(sweep) + " could not be handled: " + what);
}

void StageCore::post(std::function<void()> task) {
  {
    const std::lock_guard lock(tasks_mutex_);
    tasks_.push_back(std::move(task));
  }
  bell_->notify();
}

bool StageCore::run_tasks() {
  std::deque<std::function<void()>> tasks;
  {
    const std::lock_guard lock(tasks_mutex_);
    tasks.swap(tasks_);
  }
  for (const auto& task : tasks) task();
  return !tasks.empty();
}

bool StageCore::work() {
  bool busy = run_tasks();
  for (const auto& inlet : inlets_) inlet->drain();
  for (const auto& inlet : inlets_) busy = inlet->work() || busy;
  if (window_) window_->tick();
  for (const auto& turn : turns_) busy = turn() == Turn::kAgain || busy;
  for (const auto& inlet : inlets_) inlet->recover(session_);
  run_timers();
  return busy;
}

void StageCore::run_timers() {
  const std::int64_t now = steady_ns();
  for (Timer& timer : timers_) {
    if (now < timer.next_ns) continue;
    timer.next_ns = now + timer.period_ns;
    timer.task();
  }
}

void StageCore::wait() {
  const std::int64_t now = steady_ns();
  std::int64_t until = now + (turns_.empty() ? kIdle_ns : kTurn_ns);
  const auto sooner = [&until](std::optional<std::int64_t> t) {
    if (t) until = std::min(until, *t);
  };
  for (const auto& inlet : inlets_) sooner(inlet->deadline());
  for (const Timer& timer : timers_) sooner(timer.next_ns);
  if (window_) sooner(window_->deadline());
  bell_->wait_until(until);
}

int StageCore::run() {
  declare_service();
  while (!stopping_.load()) {
    if (!work() && !stopping_.load()) wait();
  }
  // No input from here on; what is queued stays in the accounts as queued.
  subscribers_.clear();
  for (const auto& task : on_stop_) {
    try {
      task();
    } catch (const std::exception& e) {
      log_error("could not be finished", {{"what", e.what()}});
      exit_code_ = kExitFailure;
    }
  }
  run_tasks();
  publish_status();
  close();
  return exit_code_.load();
}

void StageCore::stop() {
  stopping_ = true;
  bell_->notify();
}

void StageCore::fail(const std::string& reason) {
  log_error("giving up", {{"reason", reason}});
  {
    const std::lock_guard lock(mutex_);
    if (failure_.empty()) failure_ = reason;
  }
  exit_code_ = kExitFailure;
  stop();
}

void StageCore::close() {
  {
    const std::lock_guard lock(status_mutex_);
    status_end_ = true;
  }
  status_bell_.notify_all();
  if (status_thread_.joinable()) status_thread_.join();
  alive_.reset();
  subscribers_.clear();
  queryables_.clear();
  source_ = nullptr;
  window_.reset();
  acks_.clear();
  outlets_.clear();
  status_publisher_.reset();
}

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
    for (const Reader& reader : kReaders) {
      if (reader.key != outlet->row()) continue;
      const bool deployed = std::find(stages.begin(), stages.end(), reader.stage) != stages.end();
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
  if (!declared_) return because("starting", ServiceHealth::kStarting);
  if (!own_ready_) return because(own_reason_, ServiceHealth::kStarting);
  if (!lonely.empty()) return because("nobody listens to " + lonely, ServiceHealth::kStarting);
  if (!degraded_.empty()) {
    return because(degraded_.begin()->first + ": " + degraded_.begin()->second,
                   ServiceHealth::kDegraded);
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
  return f;
}

/// A source has no input that tells how far it is: its output does.
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

void StageCore::declare_service() {
  const Identity& id = setup_.identity;
  const std::string status_key = keys_.status(id.stage, id.instance);
  const std::string config_key = keys_.config(id.stage, id.instance);
  zenoh::PublisherOptions options;
  options.priority = zenoh::Priority::kBackground;
  options.encoding = encoding_of(Key::kStatus);
  status_publisher_ = session_.declare_publisher(status_key, options);
  queryables_.push_back(session_.declare_queryable(status_key, [this,
                                                                status_key](zenoh::Query&& query) {
    query.reply(status_key, zenoh::Bytes::own(runtime::build(status())), encoding_of(Key::kStatus));
  }));
  queryables_.push_back(
      session_.declare_queryable(config_key, [this, config_key](zenoh::Query&& query) {
        query.reply(config_key,
                    zenoh::Bytes::own(build_config(setup_.identity, setup_.values_json,
                                                   sha256_hex(setup_.result_json))),
                    encoding_of(Key::kConfig));
      }));
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
    publish_status();
    lock.lock();
    status_bell_.wait_for(lock, kStatusPeriod, [this] { return status_end_; });
  }
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
