#pragma once
// The runtime's side of pacing.

#include <atomic>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "common/messages/keys.hpp"
#include "common/runtime/async_get.hpp"
#include "common/runtime/config.hpp"
#include "common/runtime/flow.hpp"
#include "common/runtime/outlet_core.hpp"
#include "common/runtime/shared.hpp"
#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

class FlowAckCore final : public FlowAck {
 public:
  FlowAckCore(const Keys& keys, std::string sink, std::string instance, zenoh::Session& session,
              std::shared_ptr<const std::atomic<bool>> muted);
  void done_below(std::uint64_t run, std::uint64_t sweep) override;
  void waits(std::uint64_t run) override;
  /// Repeats the last acknowledgement if it is of that run: the driver may lack it.
  void publish_again(std::uint64_t run);

 private:
  Buffer message();
  void publish();

  std::string sink_, instance_, key_, encoding_;
  std::mutex mutex_;
  std::uint64_t run_ = 0;
  std::uint64_t done_below_ = 0;
  std::uint64_t seq_ = 0;
  bool any_ = false;
  std::shared_ptr<const std::atomic<bool>> muted_;
  zenoh::Publisher publisher_;
  std::optional<zenoh::Queryable> queryable_;
};

struct FlowWindowSetup {
  std::string own_stage;
  std::string own_instance;
  std::string own_result_hash;
  std::shared_ptr<const std::atomic<bool>> muted = std::make_shared<std::atomic<bool>>(false);
  FlowConfig flow;
  std::int64_t limit_ns = 120'000'000'000;
};

class FlowWindowCore final : public FlowWindow {
 public:
  FlowWindowCore(FlowWindowSetup setup, const Keys& keys, OutletCore& sweeps,
                 zenoh::Session& session, std::shared_ptr<Shared> shared,
                 std::function<void(const std::string&)> fail);

  void start_live() override;
  void start_replay(const std::string& capture_hash) override;
  bool begun() const override { return phase_ == Phase::kOpen; }
  std::uint64_t run() const override { return run_; }
  bool replay() const override { return replay_; }
  std::uint64_t resume_at() const override { return resume_at_; }
  bool may_send(std::uint64_t sweep) const override;
  bool finished() const override;
  std::uint64_t done_below() const override;

  /// To be called often by the worker.
  void tick();
  std::optional<std::int64_t> deadline() const;

 private:
  enum class Phase { kIdle, kStages, kConfigs, kAcks, kOpen };

  void on_ack(const zenoh::Sample& sample);
  /// Declares the run's owner, while this driver is the one that publishes.
  void declare_run();
  void set_run(std::uint64_t run);
  void tick_stages(std::int64_t now);
  void tick_configs(std::int64_t now);
  void tick_acks(std::int64_t now);
  void tick_open(std::int64_t now);
  /// Stages of flow.wait_for that are not ready, with what is known of them.
  std::map<std::string, std::string> missing_stages(const std::vector<zenoh::Sample>& samples);
  void say_what_is_missing(std::int64_t now, const std::map<std::string, std::string>& missing);
  std::string lagging_sinks() const;

  FlowWindowSetup setup_;
  Keys keys_;
  OutletCore& sweeps_;
  zenoh::Session& session_;
  std::shared_ptr<Shared> shared_;
  std::function<void(const std::string&)> fail_;
  Phase phase_ = Phase::kIdle;
  bool replay_ = false;
  std::string capture_hash_;
  std::uint64_t run_ = 0;
  std::uint64_t resume_at_ = 0;
  AsyncGet get_;
  std::int64_t next_try_ = 0;
  std::int64_t next_word_ = 0;
  mutable std::mutex mutex_;
  /// run_ is known, and acknowledgements for it count
  bool asked_ = false;
  /// sink -> (run, done_below), as last heard
  std::map<std::string, std::pair<std::uint64_t, std::uint64_t>> acks_;
  std::uint64_t last_done_ = 0;
  std::int64_t progress_at_ = 0;
  std::int64_t again_at_ = 0;
  std::int64_t again_wait_ns_ = 0;
  std::optional<zenoh::LivelinessToken> run_token_;
  // Last: its callbacks must end before the members they use are destroyed.
  std::vector<zenoh::Subscriber> subscribers_;
};

}  // namespace zloam::runtime
