#pragma once
// The order of one input key, without clock, threads or transport: which messages are duplicates,
// which sweep is next, what to request and when to give up (docs/protocol.md, sections 1, 3 and
// 4).
//
// Sweeps leave in ascending order within a run. The followed run is decided before (run_gate.hpp):
// here another run follows once the present one has been handed out. Numbers further ahead than
// possible are refused. Times are of any monotonic clock, ns.

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/runtime/inlet.hpp"
#include "common/runtime/number_credit.hpp"
#include "common/runtime/sweep_period.hpp"

namespace zloam::runtime {

struct SequencerLimits {
  SweepSet sweeps = SweepSet::kEvery;
  /// the answer of one publisher says nothing about the sweeps that the others hold
  bool replicas = false;
  /// InletOptions::sparse
  bool sparse = false;
  /// false: no publisher answers requests by number; what is missing is given up, in a replay too
  bool by_number = true;
  std::int64_t gap_live_ns = 30'000'000;
  std::int64_t gap_replay_ns = 200'000'000;
  /// 0: one measured sweep period
  std::int64_t late_ns = 0;
  std::int64_t replay_limit_ns = 120'000'000'000;
  /// live: sweeps held before the oldest is dropped; 0: no bound
  std::size_t newest = 4;
};

class Sequencer {
 public:
  explicit Sequencer(const SequencerLimits& limits) : limits_(limits) {}

  /// Takes the message, or returns why not; kQueueFull only of a newer run, whose missing sweeps
  /// are requested when it begins. Of this run see given_up().
  std::optional<Drop> add(Message message, std::int64_t now_ns);

  /// The next message in order, if it is there or its gap was given up.
  std::optional<Message> next(std::int64_t now_ns);

  struct Request {
    std::uint64_t run, first, last;
  };
  /// The next request; doubles its waiting time with each call that returns something. `goes_on`:
  /// the run is live and has not ended. Then a silence is a fault, and what follows the last sweep
  /// is requested as well: a link may lack the declaration by which messages would be sent here.
  std::optional<Request> request(std::int64_t now_ns, bool goes_on = false);
  /// A request was answered to its end with this many messages.
  void answered(const Request& request, std::size_t messages);

  struct GivenUp {
    std::uint64_t run, sweep;
    /// nothing: never received
    std::optional<Drop> drop;
  };
  /// Sweeps that will not be handed out, in order, since the last call.
  std::vector<GivenUp> given_up();
  /// Why messages of a newer run were not taken when that run began, since the last call.
  std::vector<Drop> refused();

  /// Time of the next work if nothing arrives.
  std::optional<std::int64_t> deadline() const;
  /// Replay: the sweep that has been missing for longer than the limit.
  std::optional<std::uint64_t> overdue(std::int64_t now_ns) const;

  /// Removes waiting messages that are not to be handled: their sweeps are missing again.
  void remove_if(const std::function<bool(const Message&)>& unfit, std::int64_t now_ns);

  /// Treats lower sweeps as handled. Returns the waiting messages that will not be handed out: of
  /// lower sweeps, and of the run that was ordered before.
  std::vector<Message> continue_at(std::uint64_t run, std::uint64_t sweep);
  /// Live: this many more may wait than `newest`. They arrived while their reader was restoring its
  /// state, not because it is too slow. The room shrinks as they are handed out.
  void make_room(std::size_t waiting) { room_ = held_.size() + waiting; }
  /// Before the start, for an instance that takes over: a replay's first message is handed out at
  /// once, whatever its number, so that the stage learns from others' copies where to continue.
  void join_at_once() { joins_at_once_ = true; }
  /// Whether a message that was handed out turns out not to be the next one, because it made the
  /// stage call continue_at(): then it is held again. If join_at_once() handed it out and the stage
  /// has not called that, the run is joined as by any other instance.
  bool takes_back(Message& message, std::int64_t now_ns);
  std::size_t held() const { return held_.size() + future_.size(); }
  std::uint64_t next_sweep() const { return next_; }
  Arrivals arrivals() const;

 private:
  void begin_run(const Message& first, std::int64_t now_ns);
  bool is_of_this_run(const Message& message) const;
  std::uint64_t most_ahead() const;
  bool in_reach(const Message& message, std::int64_t now_ns);
  bool in_reach_live(std::uint64_t beyond, std::int64_t now_ns);
  bool takes_up_far_numbers(const Message& message, std::int64_t now_ns);
  std::optional<Drop> add_to_run(Message message, std::int64_t now_ns);
  bool ready() const;
  bool contiguous(const Message& message) const;
  bool gap() const { return !held_.empty() && !ready(); }
  void note_gap(std::int64_t now_ns);
  /// A message has arrived: without a request (a silence ends), or as the answer to one.
  void note_source(bool recovered, std::int64_t now_ns);
  std::optional<Request> request_in_silence(std::int64_t now_ns);
  void give_up_gap();
  /// Messages that are missing before this one by its publisher's numbers.
  std::uint64_t missing_before(const Message& message) const;
  void begin_where_it_stands();
  /// Replay: the next message is the first one of another publisher, which may leave sweeps out.
  bool is_of_successor() const;
  void give_up_sweep(std::uint64_t sweep, std::optional<Drop> drop);
  void enforce_bound();
  void switch_run(std::int64_t now_ns);
  std::int64_t late_ns() const;
  Message take_front();

  SequencerLimits limits_;
  bool running_ = false;
  std::uint64_t run_ = 0;
  bool replay_ = false;
  /// replay_ is of this run; false after continue_at()
  bool replay_known_ = false;
  /// replay: nothing of this run was handed out yet, and its start may no longer exist
  bool joining_ = false;
  bool joins_at_once_ = false;
  bool continued_ = false;
  std::uint64_t next_ = 0;
  std::map<std::uint64_t, Message> held_;
  /// held beside limits_.newest
  std::size_t room_ = 0;
  /// messages of a newer run, kept until the current one has been handed out
  std::vector<Message> future_;
  /// sweeps given up, so that a later arrival is late and not a duplicate
  std::set<std::uint64_t> given_up_sweeps_;
  std::vector<GivenUp> given_up_;
  std::vector<Drop> refused_;
  /// last message that was handed out, to know the publisher's next number
  std::string last_instance_;
  std::optional<std::uint64_t> last_seq_;
  std::optional<std::int64_t> gap_since_;
  std::uint64_t gap_at_ = 0;
  std::int64_t ask_at_ = 0;
  std::int64_t wait_ns_ = 0;
  int asked_ = 0;
  /// since when no message has arrived without a request; nothing: to be set by the next request()
  std::optional<std::int64_t> silent_since_;
  /// the next request in a silence, and the waiting time before it
  std::optional<std::int64_t> ask_in_silence_at_;
  std::int64_t silent_wait_ns_ = 0;
  /// when nothing waited for the reader in a silence, the last time
  std::int64_t caught_up_ns_ = 0;
  SweepPeriod period_;
  NumberCredit credit_;
  /// sparse: no number was skipped in this run before the period was measured
  bool may_leap_ = false;
  std::int64_t accepted_ns_ = 0;
  /// numbers refused as too far ahead, in order among themselves: the next of them, and their count
  std::uint64_t far_next_ = 0;
  int far_count_ = 0;
};

}  // namespace zloam::runtime
