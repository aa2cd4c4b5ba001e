#pragma once
// The runtime's side of one input.

#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "common/runtime/inlet.hpp"
#include "common/runtime/outlet_core.hpp"
#include "common/runtime/seen_numbers.hpp"
#include "common/runtime/sequencer.hpp"
#include "common/runtime/shared.hpp"
#include "common/runtime/term_fence.hpp"
#include "common/zenoh/aligned.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

/// Events that an inlet reports to its stage; all on the worker.
class InletEvents {
 public:
  virtual ~InletEvents() = default;
  /// A sweep has arrived for the first time.
  virtual void saw(std::uint64_t run, std::uint64_t sweep) = 0;
  /// False: the message belongs to a run that is not followed.
  virtual bool follows(const Message& message) = 0;
  /// False: its run was left while the message waited.
  virtual bool before_message(const Message& message) = 0;
  /// started_ns 0: it was not processed here.
  virtual void after_message(const Message& message, bool ends_run) = 0;
  /// A duplicate of a sweep in replay: a stage downstream may lack its result.
  virtual void second_copy(std::uint64_t run, std::uint64_t sweep) = 0;
  virtual void overdue(const std::string& key, std::uint64_t sweep) = 0;
  virtual void handler_threw(const std::string& key, std::uint64_t sweep,
                             const std::string& what) = 0;
};

struct InletSetup {
  std::string key;
  InletOptions options;
  SequencerLimits limits;
  std::size_t queue_bytes = std::size_t{256} << 20;
  /// maximum size of one message
  std::size_t max_bytes = std::size_t{32} << 20;
  VerifyFunction verify = nullptr;
  HeaderFunction header = nullptr;
  std::function<Outcome(const Message&)> handler;
  /// for an instance that takes over from another
  bool joins_at_once = false;
  /// drops every k-th received message before it is counted, to prove recovery; 0: off
  std::uint64_t fault_every = 0;
};

class InletCore final : public Inlet, public std::enable_shared_from_this<InletCore> {
 public:
  InletCore(InletSetup setup, std::shared_ptr<Shared> shared, InletEvents& events);

  const std::string& key() const override { return setup_.key; }
  Account account() const override;
  /// For a snapshot of several inlets: the caller holds Shared::mutex.
  Account account_locked() const { return account_; }
  /// Good messages that arrived without a request, and those left to the instance that works. The
  /// caller holds Shared::mutex.
  std::uint64_t unasked_locked() const { return unasked_; }
  /// Whether such messages, good or not, still wait for the worker. The caller holds Shared::mutex.
  bool has_unread_locked() const { return unread_ > 0; }
  /// There is one message for each sweep of a run.
  bool of_each_sweep() const {
    return setup_.options.order == Order::kBySweep && !setup_.options.outside_runs;
  }
  /// In a live run that goes on, its silence is a fault.
  bool is_regular() const { return of_each_sweep() && setup_.options.regular; }
  /// Readings: small, and many per sweep.
  bool is_of_no_sweep() const { return setup_.options.order == Order::kAsTheyCome; }
  void continue_at(std::uint64_t run, std::uint64_t sweep) override;
  Arrivals arrivals() const override { return sequencer_.arrivals(); }
  std::uint32_t term() const override { return term_; }
  void settle(Message message, const std::function<Outcome(const Message&)>& work) override;

  /// Any thread: answers get <key>?kept=1, or by number, as the publisher would.
  void answer_kept(zenoh::Query& query) const;
  /// Any thread: queues, counts, wakes the worker.
  void on_sample(zenoh::Sample sample, bool recovered);

  // The worker's side.
  /// Verifies everything queued and puts it in order.
  void drain();
  /// Handles at most one message; true if there was one.
  bool work();
  /// While another instance works: discards the messages, which that instance handles. The first
  /// message afterwards starts the order again, as in a new instance.
  void put_aside();
  /// Drops waiting messages that are no longer admitted.
  void check_again();
  /// Requests missing messages from the publisher; in a run that goes on, also those that follow
  /// when it is silent.
  void recover(zenoh::Session& session, bool goes_on);
  /// Monotonic ns at which there is work even without a new message.
  std::optional<std::int64_t> deadline() const;

 private:
  struct Raw {
    zenoh::Sample sample;
    std::int64_t received_ns;
    bool recovered;
  };
  static constexpr std::size_t kMaxQueued = 8192;

  static std::size_t unasked_in(const std::deque<Raw>& batch);
  void accept(Raw raw);
  bool admitted(const Message& message);
  bool plausible(const Message& message);
  std::optional<Drop> file(Message message);
  std::optional<Message> next();
  Message take_arrival();
  void count_drop(Drop reason);
  void report_drop(Drop reason, const std::string& why);
  void note_given_up();
  void keep(const Message& message, const zenoh::AlignedBytes& bytes, const std::string& encoding);
  void note_seen(bool recovered);
  /// The text behind '?' of the next request; empty: none.
  std::string next_request(std::int64_t now_ns, bool goes_on,
                           std::optional<Sequencer::Request>* of_sweeps);
  void handle(Message message);
  void count_outcome(Outcome outcome);

  InletSetup setup_;
  std::shared_ptr<Shared> shared_;
  InletEvents& events_;
  // Under Shared::mutex.
  Account account_;
  std::uint64_t unasked_ = 0;
  /// messages without a request that the worker has not verified yet
  std::size_t unread_ = 0;
  std::deque<Raw> raw_;
  std::size_t raw_bytes_ = 0;
  std::uint64_t fault_count_ = 0;
  std::string encoding_;
  // Answers to requests, from the transport's threads.
  struct Answered {
    Sequencer::Request request;
    std::size_t messages;
  };
  std::deque<Answered> answered_;
  // Used by the worker only.
  Sequencer sequencer_;
  SeenNumbers seen_;
  TermFence fence_;
  std::uint32_t term_ = 0;
  std::deque<Message> arrivals_;
  std::size_t arrivals_bytes_ = 0;
  MessageCache kept_;
  std::uint64_t complaints_ = 0;
  /// a restored stage has called continue_at() since the last drain()
  bool goes_on_ = false;
};

}  // namespace zloam::runtime
