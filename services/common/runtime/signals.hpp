#pragma once
// SIGTERM and SIGINT as events of a thread of their own: nothing runs in a signal handler.

#include <functional>
#include <thread>

namespace zloam::runtime {

/// Blocks both signals in the calling thread, and so in all threads made after it. Call it first.
void block_stop_signals();

/// Calls on_stop at the first signal. A second one, or no end within the deadline, ends the process
/// with exit code 1: a stage that hangs must not keep its place.
class SignalWatch {
 public:
  explicit SignalWatch(std::function<void(const char* name)> on_stop);
  ~SignalWatch();
  SignalWatch(const SignalWatch&) = delete;
  SignalWatch& operator=(const SignalWatch&) = delete;

 private:
  void watch();
  std::function<void(const char*)> on_stop_;
  int signals_ = -1;
  int end_ = -1;
  std::thread thread_;
};

}  // namespace zloam::runtime
