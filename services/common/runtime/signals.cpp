#include "common/runtime/signals.hpp"

#include <poll.h>
#include <pthread.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdlib>
#include <cstring>
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
  struct sigaction hangup {};
  sigaction(SIGHUP, nullptr, &hangup);
  if (hangup.sa_handler != SIG_IGN) sigaddset(&set, SIGHUP);
  return set;
}

const char* name_of(std::uint32_t number) {
  if (number == SIGINT) return "SIGINT";
  return number == SIGHUP ? "SIGHUP" : "SIGTERM";
}

/// Descriptor of a pipe that closes when the parent ends; -1: none.
int parent_pipe() {
  const char* text = std::getenv("ZLOAM_PARENT_PIPE");
  if (text == nullptr) return -1;
  int descriptor = -1;
  const char* end = text + std::strlen(text);
  struct stat about {};
  const bool is_pipe = std::from_chars(text, end, descriptor).ptr == end &&
                       fstat(descriptor, &about) == 0 && S_ISFIFO(about.st_mode);
  if (!is_pipe) {
    log_warning("ZLOAM_PARENT_PIPE names no pipe: the stage does not end with its parent",
                {{"value", text}});
    return -1;
  }
  return descriptor;
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
  int parent = parent_pipe();
  for (;;) {
    // poll ignores negative descriptors.
    pollfd fds[3] = {{signals_, POLLIN, 0}, {end_, POLLIN, 0}, {parent, 0, 0}};
    const int n = poll(fds, 3, stopping ? static_cast<int>(kStopDeadline.count()) : -1);
    if (n < 0 && errno == EINTR) continue;
    if ((fds[1].revents & POLLIN) != 0) return;
    const bool orphaned = fds[2].revents != 0;
    // The pipe closes only once. If the parent ends after it has stopped its stages, this does not
    // count as a second signal.
    if (orphaned) parent = -1;
    if (orphaned && stopping) continue;
    if (stopping) {
      log_error(n == 0 ? "did not end in time" : "second signal");
      _exit(1);
    }
    signalfd_siginfo info{};
    if (!orphaned && read(signals_, &info, sizeof info) != sizeof info) continue;
    stopping = true;
    on_stop_(orphaned ? "who started it is gone" : name_of(info.ssi_signo));
  }
}

}  // namespace zloam::runtime
