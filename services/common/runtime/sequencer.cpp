#include "common/runtime/sequencer.hpp"

#include <algorithm>

namespace zloam::runtime {
namespace {

constexpr std::size_t kPastRuns = 64;
constexpr std::size_t kGivenUpMemory = 4096;
// A source can't number sweeps so far ahead of what was seen; more is a damaged or foreign message.
constexpr std::uint64_t kMaxGap = 1'000'000;
// Answers without any message (of replicas: answers) before a replay is joined where it stands.
constexpr int kJoinAttempts = 5;
constexpr std::size_t kMaxMissing = 256;
constexpr std::int64_t kMaxWait_ns = 8'000'000'000;

std::string instance_of(const Message& m) { return m.header->instance()->str(); }

}  // namespace

std::optional<Drop> Sequencer::add(Message message, std::int64_t now_ns) {
  const std::uint64_t run = message.header->run();
  if (std::find(past_runs_.begin(), past_runs_.end(), run) != past_runs_.end()) {
    return Drop::kWrongRun;
  }
  if (!running_) begin_run(message);
  if (run == run_) return add_to_run(std::move(message), now_ns);
  // The newest of several unknown runs can't be told: all are kept until this one has come out.
  if (limits_.newest > 0 && !message.header->replay() && future_.size() >= limits_.newest) {
    return Drop::kQueueFull;
  }
  future_.push_back(std::move(message));
  return std::nullopt;
}

void Sequencer::begin_run(const Message& first) {
  running_ = true;
  run_ = first.header->run();
  replay_ = first.header->replay();
  const std::uint64_t sweep = first.header->sweep();
  next_ = replay_ ? 0 : sweep;
  joining_ = replay_ && sweep != 0;
  held_.clear();
  given_up_sweeps_.clear();
  gap_since_.reset();
  last_stamp_.reset();
}

std::optional<Drop> Sequencer::add_to_run(Message message, std::int64_t now_ns) {
  const std::uint64_t sweep = message.header->sweep();
  replay_ = message.header->replay();
  if (sweep < next_) {
    return given_up_sweeps_.contains(sweep) ? Drop::kLate : Drop::kDuplicate;
  }
  if (held_.contains(sweep)) return Drop::kDuplicate;
  if (sweep - next_ > kMaxGap) return Drop::kInvalid;
  measure_period(message);
  held_.emplace(sweep, std::move(message));
  enforce_bound();
  note_gap(now_ns);
  return std::nullopt;
}

void Sequencer::measure_period(const Message& message) {
  const std::uint64_t sweep = message.header->sweep();
  const std::int64_t stamp = message.header->stamp_ns();
  if (last_stamp_ && sweep == last_stamp_->first + 1) {
    const std::int64_t period = stamp - last_stamp_->second;
    if (period > 1'000'000 && period < 10'000'000'000) period_ns_ = period;
  }
  last_stamp_ = {sweep, stamp};
}

std::int64_t Sequencer::late_ns() const {
  return limits_.late_ns > 0 ? limits_.late_ns : period_ns_;
}

bool Sequencer::contiguous(const Message& message) const {
  if (message.header->sweep() == next_) return true;
  if (limits_.sweeps != SweepSet::kPublisherDecides) return false;
  if (!last_seq_) return message.header->seq() == 0;
  return message.header->seq() == *last_seq_ + 1 && instance_of(message) == last_instance_;
}

bool Sequencer::ready() const { return !held_.empty() && contiguous(held_.begin()->second); }

void Sequencer::note_gap(std::int64_t now_ns) {
  if (!gap()) {
    gap_since_.reset();
    return;
  }
  if (gap_since_ && gap_at_ == next_) return;
  gap_since_ = now_ns;
  gap_at_ = next_;
  wait_ns_ = replay_ ? limits_.gap_replay_ns : limits_.gap_live_ns;
  ask_at_ = now_ns + wait_ns_;
  asked_ = 0;
}

void Sequencer::give_up_sweep(std::uint64_t sweep, std::optional<Drop> drop) {
  given_up_.push_back({run_, sweep, drop});
  given_up_sweeps_.insert(sweep);
  if (given_up_sweeps_.size() > kGivenUpMemory) given_up_sweeps_.erase(given_up_sweeps_.begin());
}

void Sequencer::give_up_gap() {
  const std::uint64_t end = held_.begin()->first;
  for (; next_ < end; ++next_) give_up_sweep(next_, std::nullopt);
  // What follows is taken as it is, whatever its publisher's number.
  last_seq_ = held_.begin()->second.header->seq() - 1;
  last_instance_ = instance_of(held_.begin()->second);
}

void Sequencer::enforce_bound() {
  while (!replay_ && limits_.newest > 0 && held_.size() > limits_.newest) {
    if (!ready()) give_up_gap();
    const Message oldest = take_front();
    give_up_sweep(oldest.header->sweep(), Drop::kQueueFull);
  }
}

Message Sequencer::take_front() {
  Message message = std::move(held_.begin()->second);
  held_.erase(held_.begin());
  next_ = message.header->sweep() + 1;
  last_seq_ = message.header->seq();
  last_instance_ = instance_of(message);
  joining_ = false;
  return message;
}

std::optional<Message> Sequencer::next(std::int64_t now_ns) {
  if (held_.empty() && !future_.empty()) switch_run(now_ns);
  if (held_.empty()) return std::nullopt;
  if (!ready()) {
    // A newer run waits: what this one lacks will not be published any more.
    const bool late = !replay_ && gap_since_ && now_ns - *gap_since_ >= late_ns();
    if (!late && future_.empty()) return std::nullopt;
    give_up_gap();
  }
  Message message = take_front();
  note_gap(now_ns);
  return message;
}

void Sequencer::switch_run(std::int64_t now_ns) {
  past_runs_.push_back(run_);
  if (past_runs_.size() > kPastRuns) past_runs_.pop_front();
  std::vector<Message> waiting = std::move(future_);
  future_.clear();
  // The lowest sweep of the new run decides where it begins.
  const std::uint64_t run = waiting.front().header->run();
  std::stable_sort(waiting.begin(), waiting.end(), [run](const Message& a, const Message& b) {
    const bool other_a = a.header->run() != run;
    const bool other_b = b.header->run() != run;
    return other_a != other_b ? other_b : a.header->sweep() < b.header->sweep();
  });
  begin_run(waiting.front());
  for (Message& message : waiting) {
    if (message.header->run() == run_) {
      add_to_run(std::move(message), now_ns);
    } else {
      future_.push_back(std::move(message));
    }
  }
}

std::optional<Sequencer::Request> Sequencer::request(std::int64_t now_ns) {
  if (!gap_since_ || now_ns < ask_at_) return std::nullopt;
  wait_ns_ = std::min(wait_ns_ * 2, kMaxWait_ns);
  ask_at_ = now_ns + wait_ns_;
  ++asked_;
  return Request{run_, next_, held_.begin()->first - 1};
}

void Sequencer::answered(const Request& request, std::size_t messages) {
  if (!joining_ || request.run != run_ || held_.empty()) return;
  if ((messages == 0 || limits_.replicas) && asked_ < kJoinAttempts) return;
  // The publisher has told what it still holds; what lies below was finished by those before us.
  next_ = held_.begin()->first;
  joining_ = false;
  gap_since_.reset();
}

std::vector<Sequencer::GivenUp> Sequencer::given_up() {
  std::vector<GivenUp> out;
  out.swap(given_up_);
  return out;
}

std::optional<std::int64_t> Sequencer::deadline() const {
  if (!gap_since_) return std::nullopt;
  return replay_ ? ask_at_ : std::min(ask_at_, *gap_since_ + late_ns());
}

std::optional<std::uint64_t> Sequencer::overdue(std::int64_t now_ns) const {
  if (!replay_ || !gap_since_ || now_ns - *gap_since_ < limits_.replay_limit_ns) {
    return std::nullopt;
  }
  return next_;
}

Arrivals Sequencer::arrivals() const {
  Arrivals a;
  a.received_below = held_.empty() ? next_ : held_.rbegin()->first + 1;
  for (std::uint64_t n = next_; n < a.received_below && a.missing.size() < kMaxMissing; ++n) {
    if (!held_.contains(n)) a.missing.push_back(n);
  }
  // Nothing is said of what the list has no room for.
  if (a.missing.size() == kMaxMissing) a.received_below = a.missing.back() + 1;
  return a;
}

void Sequencer::remove_if(const std::function<bool(const Message&)>& unfit, std::int64_t now_ns) {
  std::erase_if(held_, [&](const auto& entry) { return unfit(entry.second); });
  std::erase_if(future_, unfit);
  note_gap(now_ns);
}

void Sequencer::continue_at(std::uint64_t run, std::uint64_t sweep) {
  running_ = true;
  run_ = run;
  joining_ = false;
  next_ = sweep;
  held_.erase(held_.begin(), held_.lower_bound(sweep));
  gap_since_.reset();
}

}  // namespace zloam::runtime
