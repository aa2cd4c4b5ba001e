#pragma once
// What the tests of whole stages share: sessions on the loopback, stages on threads of their own,
// waiting for a condition without sleeping.

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "common/runtime/session_config.hpp"
#include "common/runtime/stage_core.hpp"

namespace zloam::runtime::test {

/// Long enough for a machine that has other things to do; nobody waits for it to pass.
inline constexpr std::chrono::seconds kPatience{90};

/// A TCP port of the loopback that is free now.
inline int free_port() {
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof(address);
  if (bind(fd, reinterpret_cast<sockaddr*>(&address), size) != 0 ||
      getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) != 0) {
    throw std::runtime_error("no free port");
  }
  close(fd);
  return ntohs(address.sin_port);
}

/// Peers that all know each other's ports, one for each place.
class Network {
 public:
  explicit Network(std::size_t places, bool shared_memory = false) : shared_memory_(shared_memory) {
    for (std::size_t i = 0; i < places; ++i) {
      endpoints_.push_back("tcp/127.0.0.1:" + std::to_string(free_port()));
    }
  }

  zenoh::Session open(std::size_t place) const {
    ZenohConfig config;
    config.shared_memory = shared_memory_;
    config.pool_mib = 16;
    Endpoints e;
    for (std::size_t i = 0; i < endpoints_.size(); ++i) {
      (i == place ? e.listen : e.connect).push_back(endpoints_[i]);
    }
    return zenoh::Session::open(session_config(config, e));
  }

 private:
  bool shared_memory_;
  std::vector<std::string> endpoints_;
};

/// A value that other threads change and the test waits for.
template <class T>
class Watched {
 public:
  void change(const std::function<void(T&)>& f) {
    {
      const std::lock_guard lock(mutex_);
      f(value_);
    }
    bell_.notify_all();
  }
  bool wait(const std::function<bool(const T&)>& condition) {
    std::unique_lock lock(mutex_);
    return bell_.wait_for(lock, kPatience, [&] { return condition(value_); });
  }
  T get() {
    const std::lock_guard lock(mutex_);
    return value_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable bell_;
  T value_{};
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

}  // namespace zloam::runtime::test
