#include "common/zenoh/channel.hpp"

namespace zloam::zenoh::detail {

Channel::Channel(ChannelKind kind, std::size_t capacity) : kind_(kind), capacity_(capacity) {
  if (capacity == 0) throw ZenohError("a channel needs room for at least one sample");
}

void Channel::push(Sample&& sample) {
  std::optional<Sample> oldest;  // Freed outside the lock.
  {
    std::unique_lock lock(mutex_);
    if (kind_ == ChannelKind::kFifo) {
      emptied_.wait(lock, [&] { return closed_ || samples_.size() < capacity_; });
    }
    if (closed_) return;
    if (samples_.size() == capacity_) {
      oldest = std::move(samples_.front());
      samples_.pop_front();
      ++dropped_;
    }
    samples_.push_back(std::move(sample));
  }
  filled_.notify_one();
}

std::optional<Sample> Channel::pop(std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  // wait_until on the steady clock: a wait_for that wakes early starts over.
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  filled_.wait_until(lock, deadline, [&] { return closed_ || !samples_.empty(); });
  if (samples_.empty()) return std::nullopt;
  std::optional<Sample> sample(std::move(samples_.front()));
  samples_.pop_front();
  lock.unlock();
  emptied_.notify_one();
  return sample;
}

void Channel::close() {
  {
    const std::lock_guard lock(mutex_);
    closed_ = true;
  }
  filled_.notify_all();
  emptied_.notify_all();
}

std::uint64_t Channel::dropped() const {
  const std::lock_guard lock(mutex_);
  return dropped_;
}

}  // namespace zloam::zenoh::detail
