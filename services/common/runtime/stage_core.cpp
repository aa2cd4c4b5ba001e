#include "common/runtime/stage_core.hpp"

#include <algorithm>
#include <thread>

#include "common/runtime/log.hpp"

namespace zloam::runtime {
namespace {

constexpr std::int64_t kPoll_ns = 20 * kMs;
// Without an input for this long, a stage that drains is done.
constexpr std::int64_t kDrained_ns = 100 * kMs;
constexpr std::int64_t kIdle_ns = 1000 * kMs;
constexpr std::size_t kOutputMemory = 256;
// Time that an instance stays after a hand-over, because its successor requests what it kept.
constexpr std::int64_t kLinger_ns = 2000 * kMs;
// Maximum of queries and commands that wait for the worker.
constexpr std::size_t kMostTasks = 1024;
// Maximum of readings (IMU, encoder) handled in one step of the worker. They arrive hundreds of
// times a second; one per step would be too few, as the steps follow the lidar's packets.
constexpr int kMostReadings = 64;

}  // namespace

StageCore::StageCore(StageSetup setup, zenoh::Session& session)
    : setup_(std::move(setup)),
      keys_(setup_.identity.robot, setup_.identity.sensor),
      session_(session) {
  if (setup_.fault_every > 0) {
    log_warning("FAULT INJECTION: received messages are thrown away on purpose",
                {{"every", setup_.fault_every}});
  }
  LiveConfigSetup live{setup_.identity, setup_.shared.flow.window, setup_.parameters,
                       setup_.presets,  setup_.fault_deaf_sweeps,  muted_};
  live_ = std::make_unique<LiveConfig>(
      std::move(live), EffectiveValues{0, setup_.values_json, setup_.result_json}, keys_, session_,
      bell_, [this](std::function<void()> task) { return offer(std::move(task)); });
  live_->on_revision([this](const Revision&) {
    // Queued messages may come from another revision than the one now known.
    for (const auto& inlet : inlets_) inlet->check_again();
  });
  watch_tokens();
}

StageCore::~StageCore() { close(); }

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

void StageCore::on_late_revision(std::function<void(std::uint64_t, std::uint64_t)> task) {
  live_->on_late([task = std::move(task)](const Revision& r) { task(r.run, r.from_sweep); });
}

bool StageCore::configure_for(const Message& message) {
  return live_->configure_for(message.header->run(), message.header->sweep());
}

bool StageCore::follows(const Message& message) {
  return gate_.admit(message.header->run(), message.header->replay(), steady_ns());
}

/// Fault injection: blocks the worker like an endless loop in an algorithm.
void StageCore::hang() {
  log_warning("FAULT INJECTION: the worker stops here on purpose");
  while (true) std::this_thread::yield();
}

bool StageCore::before_message(const Message& message) {
  const std::uint64_t run = message.header->run();
  if (message.header->sweep() == setup_.fault_hang_at_sweep) hang();
  if (in_run_ && run == run_) return true;
  if (!gate_.follows(run)) return false;
  {
    const std::lock_guard lock(mutex_);
    in_run_ = true;
    run_ = run;
    has_sweep_ = run_ended_ = false;
    replay_ = message.header->replay();
  }
  output_at_.clear();
  log_info("new run", {{"run", run}, {"replay", message.header->replay()}});
  live_->begin_run(run);
  for (const auto& task : on_new_run_) task(*message.header);
  return true;
}

void StageCore::after_message(const Message& message, bool ends_run) {
  const msg::Header& header = *message.header;
  // The message was held, and its run is no longer the current one.
  if (header.run() != run_) return;
  if (message.started_ns > 0) note_latencies(message);
  {
    const std::lock_guard lock(mutex_);
    last_sweep_ = has_sweep_ ? std::max(last_sweep_, header.sweep()) : header.sweep();
    has_sweep_ = true;
  }
  if (header.replay()) note_output(header.sweep());
  if (ends_run && header.end_of_run()) end_of_run(header.run());
}

void StageCore::note_latencies(const Message& message) {
  const std::int64_t now = wall_ns();
  latencies_.add("queue", static_cast<double>(message.started_ns - message.received_ns) * 1e-6);
  latencies_.add("work", static_cast<double>(now - message.started_ns) * 1e-6);
  if (const auto since_ms = host_times_->since_last_packet_ms(*message.header, now)) {
    latencies_.add("since_last_packet", *since_ms);
  }
}

void StageCore::end_of_run(std::uint64_t run) {
  {
    const std::lock_guard lock(mutex_);
    if (run_ended_ && run == run_) return;
    run_ = run;
    run_ended_ = true;
  }
  log_info("end of run", {{"run", run}});
  live_->end_run();
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
  handler_threw_ns_ = steady_ns();
  degraded("handler", "sweep " + std::to_string(sweep) + " could not be handled: " + what);
}

bool StageCore::offer(std::function<void()> task) {
  {
    const std::lock_guard lock(tasks_mutex_);
    if (tasks_.size() >= kMostTasks) return false;
    tasks_.push_back(std::move(task));
  }
  bell_->notify();
  return true;
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

bool StageCore::work_on_inputs() {
  bool busy = false;
  for (const auto& inlet : inlets_) inlet->drain();
  for (const auto& inlet : inlets_) {
    const int most = inlet->is_of_no_sweep() ? kMostReadings : 1;
    for (int i = 0; i < most && inlet->work(); ++i) busy = true;
  }
  // A restored stage may have to request its first message, too: no run has begun here then.
  const bool goes_on = !in_run_ || (!run_ended_ && !replay_);
  for (const auto& inlet : inlets_) inlet->recover(session_, goes_on);
  return busy;
}

bool StageCore::work() {
  if (is_overtaken()) overtaken_ = true;
  if (overtaken_ && steady_ns() - handed_over_ns_.load() > kLinger_ns) {
    begins_again_ = true;
    return false;
  }
  answer_takeover();
  bool busy = run_tasks();
  if (*muted_) {
    // A muted instance processes nothing: its results would compete with the active instance's, and
    // its state would mix with that one's map or frame.
    for (const auto& inlet : inlets_) inlet->put_aside();
  } else {
    busy = work_on_inputs() || busy;
  }
  if (window_) window_->tick();
  live_->tick();
  for (const auto& poll : polls_) busy = poll() == Poll::kAgain || busy;
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
  std::int64_t until = now + (polls_.empty() && !overtaken_ ? kIdle_ns : kPoll_ns);
  const auto sooner = [&until](std::optional<std::int64_t> t) {
    if (t) until = std::min(until, *t);
  };
  for (const auto& inlet : inlets_) sooner(inlet->deadline());
  for (const Timer& timer : timers_) sooner(timer.next_ns);
  sooner(live_->deadline());
  if (window_) sooner(window_->deadline());
  bell_->wait_until(until);
}

void StageCore::lost_output(const std::string& what) {
  if (what.empty()) return;
  log_error("a result is lost", {{"reason", what}});
  // The first ones tell why; a run of a night could have hundreds.
  constexpr std::size_t kMostText = 1000;
  if (lost_output_.size() < kMostText) lost_output_ += (lost_output_.empty() ? "" : "; ") + what;
  degraded("lost output", lost_output_);
  exit_code_ = kExitIo;
}

void StageCore::drain() {
  const std::int64_t until = steady_ns() + drain_ns_;
  std::int64_t idle_since = steady_ns();
  while (!*muted_ && steady_ns() < until && steady_ns() - idle_since < kDrained_ns) {
    const bool busy = work_on_inputs();
    if (run_tasks() || busy) {
      idle_since = steady_ns();
    } else {
      bell_->wait_until(steady_ns() + kPoll_ns);
    }
  }
}

int StageCore::run() {
  // For one that did not call stand_by().
  if (singleton_) singleton_->enter();
  declare_handover();
  declare_service();
  while (!stopping_.load() && !begins_again_) {
    if (!work() && !stopping_.load() && !begins_again_) wait();
  }
  if (drain_ns_ > 0 && !begins_again_) drain();
  // No input from here on; what is queued stays in the accounts as queued.
  unsubscribe();
  // After a take-over the other instance saves what is to be saved.
  if (overtaken_) on_stop_.clear();
  for (const auto& task : on_stop_) {
    try {
      task();
    } catch (const IoError& e) {
      log_error("a file is missing at the end", {{"reason", e.what()}});
      exit_code_ = kExitIo;
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

void StageCore::unsubscribe() {
  const std::lock_guard lock(subscriptions_mutex_);
  subscriptions_.clear();
}

void StageCore::close() {
  {
    const std::lock_guard lock(status_mutex_);
    status_end_ = true;
  }
  status_bell_.notify_all();
  if (status_thread_.joinable()) status_thread_.join();
  alive_.reset();
  // Before all that the answers read, such as the term in the status.
  queryables_.clear();
  drivers_.reset();
  takeover_.reset();
  singleton_.reset();
  unsubscribe();
  host_times_.reset();
  source_ = nullptr;
  window_.reset();
  acks_.clear();
  outlets_.clear();
  live_.reset();
  status_publisher_.reset();
}

}  // namespace zloam::runtime
