#include "common/runtime/sequencer.hpp"

#include <algorithm>
#include <utility>

namespace zloam::runtime {
namespace {

constexpr std::size_t kGivenUpMemory = 4096;
// Maximum distance of a replay's sweep from the next expected one. It exceeds the window, which is
// a few sweeps, and the backlog of a restarted stage, which others keep.
constexpr std::uint64_t kMostAhead = 1024;
// The same for sparse messages: a robot may stand for a day, during which there are no submaps.
constexpr std::uint64_t kMostAheadSparse = 1U << 20;
constexpr std::size_t kMostOfNextRun = 1024;
// Numbers too far ahead are accepted when nothing else has arrived for this long and kEnoughFar of
// them were in order.
constexpr std::int64_t kSilence_ns = 2'000'000'000;
constexpr int kEnoughFar = 3;
// Requests for the start of a replay that brought no message (from replicas, which hold only their
// own sweeps: any requests) before the replay is joined where it stands.
constexpr int kJoinAttempts = 5;
// Requests for what a publisher may have sent before its successor (InletOptions::sparse).
constexpr int kSuccessorAttempts = 3;
// A live run that begins with a number above this was joined in the middle. Below it the first
// messages were lost on a link that had just come up, and their publisher still has them.
constexpr std::uint64_t kMissedAtStart = 3;
constexpr std::size_t kMaxMissing = 256;
constexpr std::int64_t kMaxWait_ns = 8'000'000'000;

std::string instance_of(const Message& m) { return m.header->instance()->str(); }

}  // namespace

std::optional<Drop> Sequencer::add(Message message, std::int64_t now_ns) {
  if (!running_) begin_run(message, now_ns);
  if (is_of_this_run(message)) return add_to_run(std::move(message), now_ns);
  const std::size_t newest = message.header->replay() ? 0 : limits_.newest;
  if (future_.size() >= (newest > 0 ? newest : kMostOfNextRun)) return Drop::kQueueFull;
  future_.push_back(std::move(message));
  return std::nullopt;
}

bool Sequencer::is_of_this_run(const Message& message) const {
  return message.header->run() == run_ && (!replay_known_ || message.header->replay() == replay_);
}

void Sequencer::begin_run(const Message& first, std::int64_t now_ns) {
  running_ = true;
  run_ = first.header->run();
  replay_ = first.header->replay();
  replay_known_ = true;
  const std::uint64_t sweep = first.header->sweep();
  const bool from_the_start = replay_ || sweep <= kMissedAtStart;
  next_ = from_the_start && !joins_at_once_ ? 0 : sweep;
  joining_ = from_the_start && sweep != 0 && !joins_at_once_;
  held_.clear();
  room_ = 0;
  given_up_sweeps_.clear();
  gap_since_.reset();
  note_source(false, now_ns);
  period_.begin_run();
  credit_.begin(now_ns);
  may_leap_ = limits_.sparse;
  accepted_ns_ = now_ns;
  far_count_ = 0;
}

std::optional<Drop> Sequencer::add_to_run(Message message, std::int64_t now_ns) {
  const std::uint64_t sweep = message.header->sweep();
  replay_ = message.header->replay();
  replay_known_ = true;
  if (sweep < next_ || held_.contains(sweep)) {
    // The copy that was requested may be the first to arrive.
    if (!message.recovered) note_source(false, now_ns);
    return given_up_sweeps_.contains(sweep) ? Drop::kLate : Drop::kDuplicate;
  }
  if (!in_reach(message, now_ns) && !takes_up_far_numbers(message, now_ns)) return Drop::kInvalid;
  accepted_ns_ = now_ns;
  far_count_ = 0;
  note_source(message.recovered, now_ns);
  period_.add(sweep, message.header->stamp_ns());
  held_.emplace(sweep, std::move(message));
  enforce_bound();
  note_gap(now_ns);
  return std::nullopt;
}

std::uint64_t Sequencer::most_ahead() const {
  return limits_.sparse ? kMostAheadSparse : kMostAhead;
}

bool Sequencer::in_reach(const Message& message, std::int64_t now_ns) {
  const std::uint64_t sweep = message.header->sweep();
  const std::uint64_t below = held_.empty() ? next_ : held_.rbegin()->first + 1;
  if (!replay_) return sweep < below || in_reach_live(sweep - below, now_ns);
  // While joining, the first messages show where the run stands.
  if (joining_ && held_.empty()) return true;
  const std::uint64_t from = joining_ ? held_.begin()->first : next_;
  return sweep <= from || sweep - from <= most_ahead();
}

/// Before the period is measured, the sensor may be of any pace: a sparse input would otherwise
/// refuse the second message of a fast one, and with it all others. Once in a run, so that nobody
/// gets ahead with stamps of which no period can be measured.
bool Sequencer::in_reach_live(std::uint64_t beyond, std::int64_t now_ns) {
  if (beyond == 0 || !may_leap_ || period_.is_measured()) {
    return credit_.spend(beyond, period_.ns(), now_ns);
  }
  NumberCredit fastest = credit_;
  if (!fastest.spend(beyond, SweepPeriod::kFastest_ns, now_ns)) return false;
  may_leap_ = false;
  credit_.begin(now_ns);
  return true;
}

/// After a silence, far numbers that arrive in order are accepted: the machine was suspended, or
/// the numbers followed so far were wrong. The sweeps in between do not count as lost. Sparse ones
/// are in order with any sweeps in between: otherwise a period that was measured over a step of the
/// sensor's clock would refuse them for good.
bool Sequencer::takes_up_far_numbers(const Message& message, std::int64_t now_ns) {
  const std::uint64_t sweep = message.header->sweep();
  const bool follows = sweep == far_next_ || (limits_.sparse && sweep > far_next_);
  far_count_ = follows ? far_count_ + 1 : 1;
  far_next_ = sweep + 1;
  const bool silent = now_ns - accepted_ns_ >= kSilence_ns;
  if (replay_ || !silent || far_count_ < kEnoughFar || held() > 0) return false;
  begin_run(message, now_ns);
  last_seq_ = message.header->seq() - 1;
  last_instance_ = instance_of(message);
  return true;
}

std::int64_t Sequencer::late_ns() const {
  return limits_.late_ns > 0 ? limits_.late_ns : period_.ns();
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

std::uint64_t Sequencer::missing_before(const Message& message) const {
  const std::uint64_t seq = message.header->seq();
  const bool is_same = last_seq_ && instance_of(message) == last_instance_ && seq > *last_seq_;
  return is_same ? seq - *last_seq_ - 1 : seq;
}

void Sequencer::give_up_gap() {
  const std::uint64_t end = held_.begin()->first;
  std::uint64_t lost = end - next_;
  if (limits_.sparse) lost = std::min(lost, missing_before(held_.begin()->second));
  const std::size_t told = given_up_.size() + lost;
  for (; next_ < end; ++next_) give_up_sweep(next_, std::nullopt);
  // The other sweeps never had a message.
  given_up_.resize(told);
  // Makes the next message contiguous, whatever its seq.
  last_seq_ = held_.begin()->second.header->seq() - 1;
  last_instance_ = instance_of(held_.begin()->second);
}

void Sequencer::enforce_bound() {
  const std::size_t bound = limits_.newest + room_;
  if (replay_ || limits_.newest == 0 || held_.size() <= bound) return;
  while (held_.size() > bound) {
    if (!ready()) give_up_gap();
    const Message oldest = take_front();
    give_up_sweep(oldest.header->sweep(), Drop::kQueueFull);
  }
  // More sweeps arrive than are processed: unless the room shrinks, backlog and latency remain.
  if (room_ > 0) --room_;
}

Message Sequencer::take_front() {
  Message message = std::move(held_.begin()->second);
  held_.erase(held_.begin());
  room_ = std::min(room_, held_.size());
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
    // If a newer run waits, the missing sweeps of this one will not be published any more.
    const bool late = !replay_ && gap_since_ && now_ns - *gap_since_ >= late_ns();
    if (!late && future_.empty()) return std::nullopt;
    if (joining_ && !replay_) {
      begin_where_it_stands();
    } else {
      give_up_gap();
    }
  }
  Message message = take_front();
  note_gap(now_ns);
  return message;
}

void Sequencer::switch_run(std::int64_t now_ns) {
  std::vector<Message> waiting = std::move(future_);
  future_.clear();
  // The lowest sweep of the new run decides where it begins.
  const std::uint64_t run = waiting.front().header->run();
  const bool replay = waiting.front().header->replay();
  const auto is_other = [run, replay](const Message& m) {
    return m.header->run() != run || m.header->replay() != replay;
  };
  std::stable_sort(waiting.begin(), waiting.end(), [&](const Message& a, const Message& b) {
    if (is_other(a) != is_other(b)) return is_other(b);
    return a.header->sweep() < b.header->sweep();
  });
  begin_run(waiting.front(), now_ns);
  for (Message& message : waiting) {
    if (is_of_this_run(message)) {
      if (const auto drop = add_to_run(std::move(message), now_ns)) refused_.push_back(*drop);
    } else {
      future_.push_back(std::move(message));
    }
  }
}

void Sequencer::note_source(bool recovered, std::int64_t now_ns) {
  silent_wait_ns_ = 0;
  if (!recovered) {
    silent_since_ = now_ns;
    ask_in_silence_at_.reset();
  } else if (ask_in_silence_at_) {
    // More will follow at the sensor's pace. Those of the silence wait for no fault of the reader,
    // but a reader that stays behind gets no more room: it would fall behind ever further.
    ask_in_silence_at_ = now_ns + period_.ns();
    if (now_ns - caught_up_ns_ < kSilence_ns) ++room_;
  }
}

std::optional<Sequencer::Request> Sequencer::request_in_silence(std::int64_t now_ns) {
  if (held_.empty()) caught_up_ns_ = now_ns;
  if (!silent_since_) silent_since_ = now_ns;
  const std::int64_t at = ask_in_silence_at_.value_or(*silent_since_ + kSilence_ns);
  ask_in_silence_at_ = at;
  if (now_ns < at) return std::nullopt;
  silent_wait_ns_ = std::max(std::min(2 * silent_wait_ns_, kMaxWait_ns), period_.ns());
  ask_in_silence_at_ = now_ns + silent_wait_ns_;
  return Request{run_, next_, next_ + most_ahead()};
}

std::optional<Sequencer::Request> Sequencer::request(std::int64_t now_ns, bool goes_on) {
  if (!goes_on || !running_ || replay_) {
    ask_in_silence_at_.reset();
    silent_since_.reset();
  } else if (!gap_since_) {
    return request_in_silence(now_ns);
  }
  if (!gap_since_ || now_ns < ask_at_) return std::nullopt;
  wait_ns_ = std::min(wait_ns_ * 2, kMaxWait_ns);
  ask_at_ = now_ns + wait_ns_;
  ++asked_;
  return Request{run_, next_, held_.begin()->first - 1};
}

void Sequencer::answered(const Request& request, std::size_t messages) {
  if (request.run != run_ || held_.empty()) return;
  const bool joins = joining_ && ((messages > 0 && !limits_.replicas) || asked_ >= kJoinAttempts);
  const bool leaves_out =
      !joining_ && request.first == next_ && asked_ >= kSuccessorAttempts && is_of_successor();
  if (joins || leaves_out) begin_where_it_stands();
}

bool Sequencer::is_of_successor() const {
  return replay_ && limits_.sparse && gap() && held_.begin()->second.header->seq() == 0;
}

// The publisher has sent what it still holds: lower sweeps were finished by an earlier instance, or
// before any instance listened.
void Sequencer::begin_where_it_stands() {
  next_ = held_.begin()->first;
  joining_ = false;
  gap_since_.reset();
}

std::vector<Sequencer::GivenUp> Sequencer::given_up() {
  std::vector<GivenUp> out;
  out.swap(given_up_);
  return out;
}

std::vector<Drop> Sequencer::refused() { return std::exchange(refused_, {}); }

std::optional<std::int64_t> Sequencer::deadline() const {
  if (!gap_since_) return ask_in_silence_at_;
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
  // Report nothing about sweeps beyond the end of a full list.
  if (a.missing.size() == kMaxMissing) a.received_below = a.missing.back() + 1;
  return a;
}

void Sequencer::remove_if(const std::function<bool(const Message&)>& unfit, std::int64_t now_ns) {
  std::erase_if(held_, [&](const auto& entry) { return unfit(entry.second); });
  std::erase_if(future_, unfit);
  note_gap(now_ns);
}

bool Sequencer::takes_back(Message& message, std::int64_t now_ns) {
  const bool at_once = std::exchange(joins_at_once_, false);
  const std::uint64_t sweep = message.header->sweep();
  if (at_once && !continued_ && replay_ && sweep > 0) {
    next_ = 0;
    joining_ = true;
  }
  if (sweep < next_) return false;
  held_.emplace(sweep, std::move(message));
  note_gap(now_ns);
  return true;
}

std::vector<Message> Sequencer::continue_at(std::uint64_t run, std::uint64_t sweep) {
  running_ = true;
  continued_ = true;
  if (run != run_) replay_known_ = false;
  run_ = run;
  joining_ = false;
  next_ = sweep;
  std::vector<Message> left;
  std::erase_if(held_, [&](const auto& entry) {
    const msg::Header& header = *entry.second.header;
    const bool stays = header.run() == run && header.sweep() >= sweep;
    if (!stays) left.push_back(entry.second);
    return !stays;
  });
  gap_since_.reset();
  silent_since_.reset();
  return left;
}

}  // namespace zloam::runtime
