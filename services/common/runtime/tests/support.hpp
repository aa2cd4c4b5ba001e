#pragma once
// Shared by the tests of whole stages: sessions on the loopback, stages on threads of their own.

#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "common/runtime/session_config.hpp"
#include "common/runtime/stage_core.hpp"
#include "common/zenoh/tests/support.hpp"

namespace zloam::runtime::test {

using zenoh::test::free_port;
using zenoh::test::kPatience;
using zenoh::test::Watched;

/// The keys of the robot and sensor that setup() names.
inline const Keys kKeys("r", "top");

/// Opens peers, each with a port for its place in the chain, linked like stages.
class Network {
 public:
  explicit Network(std::size_t places, bool shared_memory = false) : shared_memory_(shared_memory) {
    for (std::size_t i = 0; i < places; ++i) {
      endpoints_.push_back(zenoh::test::endpoint(free_port()));
    }
  }

  zenoh::Session open(std::size_t place) const {
    ZenohConfig config;
    config.shared_memory = shared_memory_;
    config.pool_mib = 16;
    Endpoints e;
    e.listen.push_back(endpoints_[place]);
    e.connect.assign(endpoints_.begin() + static_cast<std::ptrdiff_t>(place) + 1, endpoints_.end());
    e.initiative = static_cast<std::uint8_t>(endpoints_.size() - place);
    return zenoh::Session::open(session_config(config, e));
  }

 private:
  bool shared_memory_;
  std::vector<std::string> endpoints_;
};

inline StageSetup setup(const std::string& stage, const std::string& instance = "i",
                        std::uint64_t fault_every = 0) {
  StageSetup s;
  s.identity = {"r", "top", stage, instance, "testhost", "0"};
  s.shared.robot = "r";
  s.shared.sensor.name = "top";
  s.shared.flow.retransmit_ms = 200;
  s.shared.flow.wait_for.clear();
  s.fault_every = fault_every;
  return s;
}

/// A stage with its own session and worker thread; stopped and joined at the end.
class RunningStage {
 public:
  RunningStage(zenoh::Session session, StageSetup stage_setup,
               const std::function<void(Stage&)>& wire)
      : session_(std::move(session)),
        stage_(std::make_unique<StageCore>(std::move(stage_setup), session_)) {
    wire(*stage_);
    thread_ = std::thread([this] { code_ = stage_->run(); });
  }
  ~RunningStage() { stop(); }

  /// The stage's exit code, after its own end or this call.
  int stop() {
    stage_->stop();
    return join();
  }
  int join() {
    if (thread_.joinable()) thread_.join();
    return code_;
  }
  StageCore& operator*() { return *stage_; }
  StageCore* operator->() { return stage_.get(); }

 private:
  zenoh::Session session_;
  std::unique_ptr<StageCore> stage_;
  std::thread thread_;
  int code_ = -1;
};

inline HeaderFields sweep_header(std::uint64_t run, std::uint64_t sweep, bool replay) {
  HeaderFields h;
  h.robot = "r";
  h.sensor = "top";
  h.instance = "d";
  h.frame = "lidar";
  h.run = run;
  h.sweep = sweep;
  h.seq = sweep;
  h.replay = replay;
  h.stamp_ns = static_cast<std::int64_t>(sweep) * 100'000'000;
  return h;
}

/// Waits until the other side's subscriber is known.
inline void wait_for_reader(zenoh::Publisher& publisher) {
  // Shared with the callback, which may outlive this call.
  const auto matched = std::make_shared<Watched<bool>>();
  publisher.on_matching([matched](bool yes) { matched->change([yes](bool& m) { m = yes; }); });
  const bool found = publisher.matching() || matched->wait([](bool m) { return m; });
  ASSERT_TRUE(found);
}

}  // namespace zloam::runtime::test
