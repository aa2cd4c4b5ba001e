#include "common/runtime/inlet_core.hpp"

#include <algorithm>
#include <atomic>
#include <exception>
#include <utility>

#include "common/runtime/log.hpp"
#include "common/runtime/recall.hpp"

namespace zloam::runtime {
namespace {

// Maximum of warnings about refused messages, so that a flood of them does not flood the log.
constexpr std::uint64_t kMaxComplaints = 20;

Drop drop_of(Outcome outcome) {
  return outcome == Outcome::kFenced ? Drop::kFenced : Drop::kFailed;
}

std::string span(std::uint64_t first, std::uint64_t last) {
  return std::to_string(first) + ".." + std::to_string(last);
}

}  // namespace

InletCore::InletCore(InletSetup setup, std::shared_ptr<Shared> shared, InletEvents& events)
    : setup_(std::move(setup)),
      shared_(std::move(shared)),
      events_(events),
      sequencer_(setup_.limits),
      seen_(setup_.limits),
      kept_(setup_.options.keep, setup_.queue_bytes) {
  account_.key = setup_.key;
  if (setup_.joins_at_once) sequencer_.join_at_once();
}

Account InletCore::account() const {
  const std::lock_guard lock(shared_->mutex);
  return account_;
}

void InletCore::continue_at(std::uint64_t run, std::uint64_t sweep) {
  const std::vector<Message> left = sequencer_.continue_at(run, sweep);
  goes_on_ = true;
  const std::lock_guard lock(shared_->mutex);
  for (const Message& message : left) {
    --account_.queued;
    // The stage has handled other copies of these sweeps, or another instance has.
    const bool is_of_run = message.header->run() == run;
    ++(is_of_run ? account_.not_mine : account_.dropped[static_cast<std::size_t>(Drop::kWrongRun)]);
  }
}

void InletCore::on_sample(zenoh::Sample sample, bool recovered) {
  if (sample.kind != zenoh::SampleKind::kPut) return;
  const std::int64_t now = wall_ns();
  {
    const std::lock_guard lock(shared_->mutex);
    if (!recovered && setup_.fault_every > 0 && ++fault_count_ % setup_.fault_every == 0) return;
    ++account_.received;
    const std::size_t size = sample.payload.size();
    if (size > setup_.max_bytes) {
      ++shared_->oversized;
      ++account_.dropped[static_cast<std::size_t>(Drop::kGarbage)];
      return;
    }
    if (raw_.size() >= kMaxQueued || raw_bytes_ + size > setup_.queue_bytes) {
      ++account_.dropped[static_cast<std::size_t>(Drop::kQueueFull)];
      return;
    }
    ++account_.queued;
    raw_bytes_ += size;
    if (!recovered) ++unread_;
    raw_.push_back({std::move(sample), now, recovered});
    shared_->rung = true;
  }
  shared_->bell.notify_all();
}

std::size_t InletCore::unasked_in(const std::deque<Raw>& batch) {
  const auto count = std::ranges::count_if(batch, [](const Raw& raw) { return !raw.recovered; });
  return static_cast<std::size_t>(count);
}

void InletCore::drain() {
  std::deque<Raw> batch;
  std::deque<Answered> answered;
  {
    const std::lock_guard lock(shared_->mutex);
    batch.swap(raw_);
    answered.swap(answered_);
    raw_bytes_ = 0;
  }
  if (std::exchange(goes_on_, false)) sequencer_.make_room(batch.size());
  const std::size_t unasked = unasked_in(batch);
  for (Raw& raw : batch) accept(std::move(raw));
  if (unasked > 0) {
    const std::lock_guard lock(shared_->mutex);
    unread_ -= unasked;
  }
  for (const Answered& a : answered) sequencer_.answered(a.request, a.messages);
  note_given_up();
}

void InletCore::count_drop(Drop reason) {
  const std::lock_guard lock(shared_->mutex);
  --account_.queued;
  ++account_.dropped[static_cast<std::size_t>(reason)];
}

void InletCore::report_drop(Drop reason, const std::string& why) {
  count_drop(reason);
  if (++complaints_ > kMaxComplaints) return;
  log_warning("message dropped",
              {{"key", setup_.key}, {"reason", drop_name(reason)}, {"why", why}});
}

void InletCore::accept(Raw raw) {
  const zenoh::AlignedBytes bytes =
      zenoh::view_aligned(std::move(raw.sample.payload), &shared_->transfer);
  if (bytes.torn()) {
    report_drop(Drop::kTorn, "its shared memory was written again before it was read");
    return;
  }
  const VerifyResult result = setup_.verify(bytes.data(), raw.sample.encoding);
  if (!result.ok()) {
    report_drop(result.status == VerifyStatus::kGarbage ? Drop::kGarbage : Drop::kInvalid,
                result.reason);
    return;
  }
  Message message;
  message.owner = std::make_shared<const zenoh::AlignedBytes>(bytes);
  message.bytes = bytes.data();
  message.header = setup_.header(message.bytes);
  message.received_ns = raw.received_ns;
  message.recovered = raw.recovered;
  if (!setup_.options.outside_runs && !events_.follows(message)) {
    report_drop(Drop::kWrongRun, "its run " + std::to_string(message.header->run()) + " of " +
                                     message.header->instance()->str() +
                                     " is not the one that is followed");
    return;
  }
  // Recovered messages pass: what an instance published before it was overtaken remains valid.
  const msg::Header& header = *message.header;
  if (!raw.recovered && fence_.refuses(header.run(), header.term(), steady_ns())) {
    report_drop(Drop::kFenced, "sweep " + std::to_string(header.sweep()) + " of " +
                                   header.instance()->str() +
                                   ", which another instance has overtaken");
    return;
  }
  if (!admitted(message) || !plausible(message)) return;
  const std::uint64_t run = header.run();
  const std::uint64_t sweep = header.sweep();
  // In a replay, a duplicate means that its publisher sees no progress and wants the output again.
  // A recovered copy that arrives after the original does not mean that.
  const bool echo = message.header->replay() && !raw.recovered;
  const Message kept = message;
  if (const auto drop = file(std::move(message))) {
    if (*drop == Drop::kInvalid) {
      report_drop(*drop, "its number is further ahead than there was time for: sweep " +
                             std::to_string(sweep) + ", seq " + std::to_string(kept.header->seq()));
    } else {
      count_drop(*drop);
    }
    if (*drop == Drop::kDuplicate && echo) events_.second_copy(run, sweep);
    return;
  }
  if (!raw.recovered) fence_.took(run, header.term(), steady_ns());
  if (!raw.recovered || term_ == 0) term_ = header.term();
  keep(kept, bytes, raw.sample.encoding);
  events_.saw(run, sweep);
  note_seen(raw.recovered);
}

bool InletCore::admitted(const Message& message) {
  if (!setup_.options.admit || setup_.options.admit(message)) return true;
  report_drop(Drop::kInvalid, "sweep " + std::to_string(message.header->sweep()) +
                                  " with another revision of the configuration");
  return false;
}

bool InletCore::plausible(const Message& message) {
  if (!setup_.options.implausible || message.header->replay()) return true;
  const std::string why = setup_.options.implausible(message);
  if (why.empty()) return true;
  report_drop(Drop::kInvalid, "sweep " + std::to_string(message.header->sweep()) + " of " +
                                  message.header->instance()->str() + ": " + why);
  return false;
}

void InletCore::check_again() {
  if (!setup_.options.admit) return;
  sequencer_.remove_if([this](const Message& message) { return !admitted(message); }, steady_ns());
}

void InletCore::keep(const Message& message, const zenoh::AlignedBytes& bytes,
                     const std::string& encoding) {
  if (setup_.options.keep == 0) return;
  const msg::Header& h = *message.header;
  if (kept_.find(h.run(), h.sweep())) return;
  {
    const std::lock_guard lock(shared_->mutex);
    encoding_ = encoding;
  }
  kept_.put({h.run(), h.sweep(), h.seq(), bytes.to_keep(), h.replay()});
}

void InletCore::answer_kept(zenoh::Query& query) const {
  std::string encoding;
  {
    const std::lock_guard lock(shared_->mutex);
    encoding = encoding_;
  }
  const bool all = query.parameters() == kKept;
  for (const auto& entry : all ? kept_.all() : kept_.select(query.parameters())) {
    query.reply(setup_.key, entry.payload, encoding);
  }
}

void InletCore::note_seen(bool recovered) {
  const std::lock_guard lock(shared_->mutex);
  ++(recovered ? account_.recovered : unasked_);
}

std::optional<Drop> InletCore::file(Message message) {
  if (setup_.options.order == Order::kBySweep) {
    return sequencer_.add(std::move(message), steady_ns());
  }
  const msg::Header& header = *message.header;
  // A process that stands by again keeps its name, but its numbers count from 0 when it takes over.
  const std::string life = header.instance()->str() + '/' + std::to_string(header.term());
  if (const auto drop = seen_.add(life, header.seq(), header.replay(), steady_ns())) return drop;
  const std::size_t size = message.bytes.size();
  if (arrivals_.size() >= kMaxQueued || arrivals_bytes_ + size > setup_.queue_bytes) {
    return Drop::kQueueFull;
  }
  arrivals_bytes_ += size;
  arrivals_.push_back(std::move(message));
  const std::size_t newest = setup_.limits.newest;
  if (newest > 0 && arrivals_.size() > newest && !arrivals_.front().header->replay()) {
    take_arrival();
    count_drop(Drop::kQueueFull);
  }
  return std::nullopt;
}

void InletCore::note_given_up() {
  for (const Drop reason : sequencer_.refused()) count_drop(reason);
  for (const Sequencer::GivenUp& g : sequencer_.given_up()) {
    {
      const std::lock_guard lock(shared_->mutex);
      if (g.drop) {
        --account_.queued;
        ++account_.dropped[static_cast<std::size_t>(*g.drop)];
      } else {
        ++account_.lost;
      }
    }
    const char* reason = g.drop ? drop_name(*g.drop) : "lost";
    if (setup_.options.on_given_up) setup_.options.on_given_up(g.run, g.sweep, reason);
  }
}

std::optional<Message> InletCore::next() {
  if (setup_.options.order == Order::kBySweep) return sequencer_.next(steady_ns());
  if (arrivals_.empty()) return std::nullopt;
  return take_arrival();
}

Message InletCore::take_arrival() {
  Message message = std::move(arrivals_.front());
  arrivals_.pop_front();
  arrivals_bytes_ -= message.bytes.size();
  return message;
}

bool InletCore::work() {
  std::optional<Message> message = next();
  note_given_up();
  if (!message) return false;
  handle(std::move(*message));
  return true;
}

void InletCore::put_aside() {
  note_given_up();
  std::deque<Raw> batch;
  {
    const std::lock_guard lock(shared_->mutex);
    batch.swap(raw_);
    raw_bytes_ = 0;
    answered_.clear();
    const std::size_t unasked = unasked_in(batch);
    unread_ -= unasked;
    unasked_ += unasked;
    const std::size_t waiting = batch.size() + sequencer_.held() + arrivals_.size();
    account_.queued -= waiting;
    account_.not_mine += waiting;
  }
  sequencer_ = Sequencer(setup_.limits);
  arrivals_.clear();
  arrivals_bytes_ = 0;
}

void InletCore::handle(Message message) {
  if (!setup_.options.outside_runs && !events_.before_message(message)) {
    count_drop(Drop::kWrongRun);
    return;
  }
  if (setup_.options.order == Order::kBySweep && sequencer_.takes_back(message, steady_ns()))
    return;
  settle(std::move(message), setup_.handler);
}

void InletCore::settle(Message message, const std::function<Outcome(const Message&)>& work) {
  {
    const std::lock_guard lock(shared_->mutex);
    --account_.queued;
    ++account_.in_work;
  }
  message.started_ns = wall_ns();
  Outcome outcome = Outcome::kInvalid;
  try {
    outcome = work(message);
  } catch (const std::exception& e) {
    events_.handler_threw(setup_.key, message.header->sweep(), e.what());
  }
  count_outcome(outcome);
  if (outcome == Outcome::kHeld) return;
  if (setup_.options.outside_runs) return;
  if (outcome == Outcome::kNotMine) message.started_ns = 0;
  events_.after_message(message, setup_.options.ends_run);
}

void InletCore::count_outcome(Outcome outcome) {
  const std::lock_guard lock(shared_->mutex);
  --account_.in_work;
  switch (outcome) {
    case Outcome::kProcessed:
      ++account_.processed;
      return;
    case Outcome::kNotMine:
      ++account_.not_mine;
      return;
    case Outcome::kHeld:
      ++account_.queued;
      return;
    case Outcome::kFenced:
    case Outcome::kInvalid:
      ++account_.dropped[static_cast<std::size_t>(drop_of(outcome))];
      return;
  }
}

std::string InletCore::next_request(std::int64_t now, bool goes_on,
                                    std::optional<Sequencer::Request>* of_sweeps) {
  if (setup_.options.order == Order::kAsTheyCome) {
    const auto request = seen_.request(now);
    {
      const std::lock_guard lock(shared_->mutex);
      account_.lost = seen_.lost();
    }
    return request ? "seq=" + span(request->first, request->last) : std::string();
  }
  *of_sweeps = sequencer_.request(now, goes_on && of_each_sweep());
  if (!*of_sweeps) return {};
  return "run=" + std::to_string((*of_sweeps)->run) +
         ";sweep=" + span((*of_sweeps)->first, (*of_sweeps)->last);
}

void InletCore::recover(zenoh::Session& session, bool goes_on) {
  const std::int64_t now = steady_ns();
  const bool by_sweep = setup_.options.order == Order::kBySweep;
  if (const auto missing = by_sweep ? sequencer_.overdue(now) : seen_.overdue(now)) {
    events_.overdue(setup_.key, *missing);
  }
  std::optional<Sequencer::Request> of_sweeps;
  const std::string wanted = next_request(now, goes_on, &of_sweeps);
  if (wanted.empty()) return;
  log(Level::kDebug, "asking for what is missing", {{"key", setup_.key}, {"wanted", wanted}});
  // The answer may arrive after the stage was destroyed, so its callbacks keep the inlet alive.
  const auto self = shared_from_this();
  const auto count = std::make_shared<std::atomic<std::size_t>>(0);
  session.get(
      setup_.key + "?" + wanted,
      [self, count](zenoh::Reply&& reply) {
        if (!reply.ok()) return;
        count->fetch_add(1);
        self->on_sample(std::move(*reply.sample), true);
      },
      [self, count, of_sweeps] {
        const std::lock_guard lock(self->shared_->mutex);
        if (of_sweeps) self->answered_.push_back({*of_sweeps, count->load()});
        self->shared_->rung = true;
        self->shared_->bell.notify_all();
      });
}

std::optional<std::int64_t> InletCore::deadline() const {
  return setup_.options.order == Order::kBySweep ? sequencer_.deadline() : seen_.deadline();
}

}  // namespace zloam::runtime
