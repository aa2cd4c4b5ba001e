#pragma once
// Events that end a stage, handled by a separate thread: nothing runs in a signal handler.
//
// SIGTERM, SIGINT, SIGHUP (unless it is ignored, as under nohup), and the end of the parent
// process: ZLOAM_PARENT_PIPE names the inherited end of a pipe whose other end only the parent has.
// It closes when the parent ends, for whatever reason.

#include <functional>
#include <thread>

namespace zloam::runtime {

/// Blocks the signals in the calling thread and all threads created later. Call it first.
void block_stop_signals();

/// Calls on_stop at the first signal. A second one, or no end within the deadline, ends the process
/// with exit code 1: a stage that hangs must not keep its place.
class SignalWatch {
 public:
  explicit SignalWatch(std::function<void(const char* cause)> on_stop);
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
