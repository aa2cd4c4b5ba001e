#pragma once
// The order of one input key, without clock, threads or transport: which messages are second
// copies, which sweep is next, what to ask for and when to give up (docs/protocol.md, sections 1, 3
// and 4).
//
// Sweeps leave in ascending order within a run. Which run is followed is decided before
// (run_gate.hpp): here another one is the next, once this one has come out. Numbers far ahead of
// what can have happened are refused. Times are of any monotonic clock, ns.

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
  /// what one publisher answers says nothing of what the others hold
  bool replicas = false;
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

  /// Takes the message, or says why not. kQueueFull never comes back here: see given_up().
  std::optional<Drop> add(Message message, std::int64_t now_ns);

  /// The next message in order, if it is there or its gap was given up.
  std::optional<Message> next(std::int64_t now_ns);

  struct Request {
    std::uint64_t run, first, last;
  };
  /// What to ask for now; doubles its patience with each call that returns something.
  std::optional<Request> request(std::int64_t now_ns);
  /// A request was answered to its end with so many messages.
  void answered(const Request& request, std::size_t messages);

  struct GivenUp {
    std::uint64_t run, sweep;
    /// nothing: never received
    std::optional<Drop> drop;
  };
  /// Sweeps that will not come out, in order, since the last call.
  std::vector<GivenUp> given_up();

  /// When something is to be done though nothing arrives.
  std::optional<std::int64_t> deadline() const;
  /// Replay: the sweep that has been missing for longer than the limit.
  std::optional<std::uint64_t> overdue(std::int64_t now_ns) const;

  /// Messages that wait and are not to be taken after all: their sweeps are missing again.
  void remove_if(const std::function<bool(const Message&)>& unfit, std::int64_t now_ns);

  /// Sweeps below are taken for handled.
  void continue_at(std::uint64_t run, std::uint64_t sweep);
  /// Live: so many more may wait than `newest` says. They came while their reader restored its
  /// state, which is no sign that it is too slow. The room goes as they come out.
  void make_room(std::size_t waiting) { room_ = held_.size() + waiting; }
  /// Before the start, of an instance that goes on in another's place: a replay's first message comes
  /// out at once, whatever its number, so that its stage learns by what others keep where to go on.
  void join_at_once() { joins_at_once_ = true; }
  /// Whether a message that has come out is not the next one after all, by what was learnt from it:
  /// then it was taken back. Where nothing was learnt the run is joined as by anybody else.
  bool takes_back(Message& message, std::int64_t now_ns);
  std::size_t held() const { return held_.size() + future_.size(); }
  std::uint64_t next_sweep() const { return next_; }
  Arrivals arrivals() const;

 private:
  void begin_run(const Message& first, std::int64_t now_ns);
  bool is_of_this_run(const Message& message) const;
  bool in_reach(const Message& message, std::int64_t now_ns);
  bool takes_up_far_numbers(const Message& message, std::int64_t now_ns);
  std::optional<Drop> add_to_run(Message message, std::int64_t now_ns);
  bool ready() const;
  bool contiguous(const Message& message) const;
  bool gap() const { return !held_.empty() && !ready(); }
  void note_gap(std::int64_t now_ns);
  void give_up_gap();
  void begin_where_it_stands();
  void give_up_sweep(std::uint64_t sweep, std::optional<Drop> drop);
  void enforce_bound();
  void switch_run(std::int64_t now_ns);
  std::int64_t late_ns() const;
  Message take_front();

  SequencerLimits limits_;
  bool running_ = false;
  std::uint64_t run_ = 0;
  bool replay_ = false;
  /// replay_ is of this run; not so after continue_at()
  bool replay_known_ = false;
  /// replay: nothing has come out of this run yet, and its start may not exist any more
  bool joining_ = false;
  bool joins_at_once_ = false;
  bool continued_ = false;
  std::uint64_t next_ = 0;
  std::map<std::uint64_t, Message> held_;
  /// held beside limits_.newest
  std::size_t room_ = 0;
  /// messages of a newer run, kept until the current one has come out
  std::vector<Message> future_;
  /// sweeps given up, so that a later arrival is late and not a duplicate
  std::set<std::uint64_t> given_up_sweeps_;
  std::vector<GivenUp> given_up_;
  /// last message that came out, to know the publisher's next number
  std::string last_instance_;
  std::optional<std::uint64_t> last_seq_;
  std::optional<std::int64_t> gap_since_;
  std::uint64_t gap_at_ = 0;
  std::int64_t ask_at_ = 0;
  std::int64_t wait_ns_ = 0;
  int asked_ = 0;
  SweepPeriod period_;
  NumberCredit credit_;
  std::int64_t accepted_ns_ = 0;
  /// refused as too far ahead, in order among themselves: the next of them, and how many
  std::uint64_t far_next_ = 0;
  int far_count_ = 0;
};

}  // namespace zloam::runtime
