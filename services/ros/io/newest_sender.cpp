#include "ros/io/newest_sender.hpp"

#include <chrono>

namespace zloam::ros {

NewestSender::NewestSender(std::function<void(const Message&)> send, std::function<void()> unblock)
    : send_(std::move(send)), unblock_(std::move(unblock)), thread_([this] { run(); }) {}

NewestSender::~NewestSender() {
  bool ended = false;
  {
    std::unique_lock lock(mutex_);
    ends_ = true;
    changed_.notify_all();
    ended = changed_.wait_for(lock, std::chrono::seconds(1), [this] { return ended_; });
  }
  if (!ended) unblock_();
  thread_.join();
}

void NewestSender::send(Message message) {
  const std::lock_guard lock(mutex_);
  waiting_ = std::move(message);
  changed_.notify_all();
}

void NewestSender::run() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return ends_ || waiting_; });
    // What waits at the end is sent as well.
    if (!waiting_) break;
    const Message message = *std::exchange(waiting_, std::nullopt);
    lock.unlock();
    send_(message);
    lock.lock();
  }
  ended_ = true;
  changed_.notify_all();
}

}  // namespace zloam::ros
