#include "common/runtime/signals.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <stdexcept>

#include "common/runtime/log.hpp"

namespace zloam::runtime {
namespace {

// Longer than saving a large map takes, shorter than what a supervisor waits before SIGKILL.
constexpr std::chrono::milliseconds kStopDeadline{9000};

sigset_t stop_signals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  sigaddset(&set, SIGINT);
  return set;
}

}  // namespace

void block_stop_signals() {
  const sigset_t set = stop_signals();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
}

SignalWatch::SignalWatch(std::function<void(const char*)> on_stop) : on_stop_(std::move(on_stop)) {
  const sigset_t set = stop_signals();
  signals_ = signalfd(-1, &set, SFD_CLOEXEC);
  end_ = eventfd(0, EFD_CLOEXEC);
  if (signals_ < 0 || end_ < 0) throw std::runtime_error("signalfd or eventfd is not available");
  thread_ = std::thread([this] { watch(); });
}

SignalWatch::~SignalWatch() {
  const std::uint64_t one = 1;
  // Can't fail: the counter of an eventfd that is written once does not overflow.
  [[maybe_unused]] const auto written = write(end_, &one, sizeof one);
  thread_.join();
  close(signals_);
  close(end_);
}

void SignalWatch::watch() {
  bool stopping = false;
  for (;;) {
    pollfd fds[2] = {{signals_, POLLIN, 0}, {end_, POLLIN, 0}};
    const int n = poll(fds, 2, stopping ? static_cast<int>(kStopDeadline.count()) : -1);
    if (n < 0 && errno == EINTR) continue;
    if ((fds[1].revents & POLLIN) != 0) return;
    if (stopping) {
      log_error(n == 0 ? "did not end in time" : "second signal");
      _exit(1);
    }
    signalfd_siginfo info{};
    if (read(signals_, &info, sizeof info) != sizeof info) continue;
    stopping = true;
    on_stop_(info.ssi_signo == SIGINT ? "SIGINT" : "SIGTERM");
  }
}

}  // namespace zloam::runtime
