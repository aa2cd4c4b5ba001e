#pragma once
// The runtime's side of a stage: owns inputs, outputs and the worker's loop.

#include <atomic>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "common/runtime/flow_core.hpp"
#include "common/runtime/host_times.hpp"
#include "common/runtime/inlet_core.hpp"
#include "common/runtime/input_watch.hpp"
#include "common/runtime/live_config.hpp"
#include "common/runtime/outlet_core.hpp"
#include "common/runtime/run_gate.hpp"
#include "common/runtime/singleton.hpp"
#include "common/runtime/stage.hpp"
#include "common/runtime/statistics.hpp"
#include "common/runtime/status.hpp"
#include "common/runtime/takeover_request.hpp"

namespace zloam::runtime {

struct StageSetup {
  Identity identity;
  SharedConfig shared;
  /// effective configuration as JSON: all of it, and the part that can change a result
  std::string values_json = "{}";
  std::string result_json = "{}";
  /// null: nothing can be changed while running
  Parameters* parameters = nullptr;
  /// --set-at
  std::vector<Revision> presets;
  /// ZLOAM_FAULT_DROP_EVERY
  std::uint64_t fault_every = 0;
  /// ZLOAM_FAULT_DEAF_SWEEPS
  std::uint64_t fault_deaf_sweeps = 0;
  /// ZLOAM_FAULT_HANG_AT_SWEEP
  std::optional<std::uint64_t> fault_hang_at_sweep;
  /// StageSpec::longest_work
  std::chrono::milliseconds longest_work{1000};
  /// Another instance is certainly active: this process was overtaken before.
  bool was_overtaken = false;
  /// Replaces this process with a new one at once, if the worker hangs. Null: no effect.
  std::function<void()> start_again = nullptr;
};

class StageCore final : public Stage, private InletEvents {
 public:
  StageCore(StageSetup setup, zenoh::Session& session);
  ~StageCore() override;

  /// Waits, before anything is wired, while another instance is active: the status reports it.
  /// False: this instance was stopped meanwhile.
  bool stand_by();
  /// Works until stop() or fail(); declares the token, publishes status. Call it once.
  int run();
  /// Undeclares everything; the session may be closed afterwards.
  void close();
  /// Another instance has taken over; this one is to restart and stand by, unless it was told to
  /// stop meanwhile.
  bool begins_again() const { return begins_again_ && !stopping_.load(); }

  const Identity& identity() const override { return setup_.identity; }
  const SharedConfig& shared() const override { return setup_.shared; }
  const Keys& keys() const override { return keys_; }
  zenoh::Session& session() override { return session_; }
  Outlet& outlet(Key key) override;
  Outlet& outlet_at(Key key, const std::string& full_key) override;
  FlowWindow& flow_window(Outlet& sweeps) override;
  FlowAck& flow_ack(const std::string& sink) override;
  void command(const std::string& verb, CommandHandler handler) override;
  void answer(const std::string& full_key, std::function<void(Answer&)> handler) override;
  bool configure_for(const Message& message) override;
  std::uint32_t config_rev(std::uint64_t run, std::uint64_t sweep) const override {
    return live_->rev_at(run, sweep);
  }
  bool revision_agrees(std::string_view other_stage, const msg::Header& header) override {
    return live_->agrees(other_stage, header);
  }
  void answer_set_if(std::function<bool(std::uint64_t)> mine) override {
    live_->answer_set_if(std::move(mine));
  }
  void on_late_revision(std::function<void(std::uint64_t, std::uint64_t)> task) override;
  void on_poll(std::function<Poll()> poll) override { polls_.push_back(std::move(poll)); }
  void every(std::chrono::milliseconds period, std::function<void()> task) override;
  void on_end_of_run(std::function<void(std::uint64_t)> task) override;
  void on_new_run(std::function<void(const msg::Header&)> task) override;
  void on_hand_over(std::function<void(bool)> task) override {
    on_hand_over_.push_back(std::move(task));
  }
  void on_stop(std::function<void()> task) override { on_stop_.push_back(std::move(task)); }
  void lost_output(const std::string& what) override;
  void drain_on_stop(std::chrono::milliseconds at_most) override {
    drain_ns_ = at_most.count() * kMs;
  }
  void end_of_run(std::uint64_t run) override;
  void notify() override { bell_->notify(); }
  void stop() override;
  void fail(const std::string& reason) override;
  bool stopping() const override { return stopping_.load(); }
  void figure(const std::string& name, double value) override;
  void latency(const std::string& name, double ms) override { latencies_.add(name, ms); }
  void degraded(const std::string& topic, const std::string& reason) override;
  void note_term(std::uint32_t term) override;
  bool overtook() const override { return singleton_ && singleton_->has_passed(); }
  void ready(bool yes, const std::string& reason) override;
  std::vector<Account> accounts() const override;
  std::int64_t now_ns() const override { return wall_ns(); }

  StatusFields status() const;

 protected:
  Inlet& add_inlet(Key key, const std::string& full_key, const InletOptions& options,
                   VerifyFunction verify, HeaderFunction header,
                   std::function<Outcome(const Message&)> handler) override;

 private:
  struct Subscription;
  void saw(std::uint64_t run, std::uint64_t sweep) override { live_->saw(run, sweep); }
  bool follows(const Message& message) override;
  bool before_message(const Message& message) override;
  void after_message(const Message& message, bool ends_run) override;
  void second_copy(std::uint64_t run, std::uint64_t sweep) override;
  void overdue(const std::string& key, std::uint64_t sweep) override;
  void handler_threw(const std::string& key, std::uint64_t sweep, const std::string& what) override;

  /// Records that an output of the sweep is published now. False if one was published just before:
  /// then a second copy came from a replica, not from a publisher that lacks the output.
  bool note_output(std::uint64_t sweep);
  [[noreturn]] static void hang();
  void note_latencies(const Message& message);
  void declare_service();
  void declare_status();
  bool has_elder();
  void wait_for_turn();
  void declare_takeover();
  void answer_takeover();
  void take_over(const char* why, zenoh::Query* query);
  void declare_handover();
  CommandReply hand_over(const std::string& arguments_json);
  bool is_overtaken() const;
  void watch_overtaken();
  void watch_tokens();
  void watch_second();
  void watch_handlers();
  void watch_oversized();
  bool run_tasks();
  bool work_on_inputs();
  bool work();
  void drain();
  void run_timers();
  void wait();
  /// Runs a task on the worker. Anyone may send requests without end: false when too many wait.
  bool offer(std::function<void()> task);
  void status_loop();
  void watch_overload();
  void watch_inputs();
  void subscribe(Subscription& subscription);
  /// Informs the publishers again that this input is read.
  void subscribe_again(const std::map<std::string, std::string>& silences);
  void unsubscribe();
  /// Asks other hosts for their time, and reports their clocks' offsets.
  void watch_clocks();
  /// Reports the endpoints of zenoh.connect that have no link.
  void watch_links();
  void publish_status();
  ServiceHealth health(std::string* reason) const;
  void note_source(StatusFields* f) const;
  /// Outputs that a stage of this deployment reads and that have no subscriber yet.
  std::string unmatched() const;

  StageSetup setup_;
  Keys keys_;
  zenoh::Session& session_;
  std::shared_ptr<Shared> bell_ = std::make_shared<Shared>();
  std::int64_t started_ns_ = wall_ns();
  double rss_start_mib_ = process_usage().rss_mib;

  /// shared with the outlets, acknowledgements and answers; true: nothing is sent
  std::shared_ptr<std::atomic<bool>> muted_ = std::make_shared<std::atomic<bool>>(false);
  std::optional<Singleton> singleton_;
  const std::shared_ptr<TakeoverRequest> takeover_request_ = std::make_shared<TakeoverRequest>();
  std::optional<zenoh::Queryable> takeover_;
  /// whether another instance can take over this stage without loss
  bool replaceable_ = false;

  std::vector<std::shared_ptr<InletCore>> inlets_;
  /// One for each inlet.
  struct Subscription {
    std::shared_ptr<InletCore> inlet;
    std::optional<zenoh::Subscriber> subscriber;
    /// monotonic: when it is declared again if nothing arrives; interval to the next declaration
    std::int64_t again_ns = 0, wait_ns = 0;
  };
  std::mutex subscriptions_mutex_;
  std::vector<Subscription> subscriptions_;
  std::vector<std::unique_ptr<OutletCore>> outlets_;
  std::vector<std::unique_ptr<FlowAckCore>> acks_;
  std::unique_ptr<FlowWindowCore> window_;
  std::unique_ptr<LiveConfig> live_;
  /// the outlet that the window paces; one of outlets_
  std::atomic<const OutletCore*> source_{nullptr};
  std::vector<zenoh::Queryable> queryables_;
  /// from declare_service() to close()
  std::optional<HostTimes> host_times_;
  std::vector<std::function<Poll()>> polls_;
  struct Timer {
    std::int64_t period_ns, next_ns;
    std::function<void()> task;
  };
  std::vector<Timer> timers_;
  std::vector<std::function<void(std::uint64_t)>> on_end_of_run_;
  std::vector<std::function<void(const msg::Header&)>> on_new_run_;
  std::vector<std::function<void(bool)>> on_hand_over_;
  std::vector<std::function<void()>> on_stop_;
  std::int64_t drain_ns_ = 0;
  std::string lost_output_;

  std::mutex tasks_mutex_;
  std::deque<std::function<void()>> tasks_;

  std::atomic<bool> stopping_{false};
  std::atomic<bool> overtaken_{false};
  /// monotonic; 0: never
  std::atomic<std::int64_t> handed_over_ns_{0};
  /// another instance is asked to take over, or has done so
  std::atomic<bool> leaving_{false};
  bool took_over_ = false;
  bool begins_again_ = false;
  std::atomic<int> exit_code_{0};
  RunGate gate_;
  /// replay: sweep -> when its outputs were last published, monotonic ns
  std::map<std::uint64_t, std::int64_t> output_at_;
  // Reported to others: under mutex_.
  mutable std::mutex mutex_;
  bool in_run_ = false;
  std::uint64_t run_ = 0;
  std::uint64_t last_sweep_ = 0;
  bool has_sweep_ = false;
  bool run_ended_ = false;
  bool replay_ = false;
  bool declared_ = false;
  bool own_ready_ = true;
  std::string own_reason_;
  std::string failure_;
  std::map<std::string, std::string> degraded_;
  std::map<std::string, double> figures_;
  Latencies latencies_;
  /// monotonic; 0: never, or it is over
  std::atomic<std::int64_t> handler_threw_ns_{0};

  // Used by the status thread only.
  std::uint64_t overload_dropped_ = 0;
  int looks_without_drop_ = 0;
  InputWatch input_watch_;
  std::string said_of_others_;
  std::uint64_t oversized_ = 0;
  int looks_at_heap_ = 0;
  int looks_overtaken_ = 0;
  int looks_without_link_ = 0;

  std::optional<zenoh::LivelinessToken> alive_;
  std::optional<zenoh::Subscriber> drivers_;
  std::optional<zenoh::Publisher> status_publisher_;
  std::mutex status_mutex_;
  std::condition_variable status_bell_;
  bool status_end_ = false;
  std::thread status_thread_;
};

}  // namespace zloam::runtime
