#pragma once
// The bounded queue behind a ChannelSubscriber. Not for other folders.

#include <condition_variable>
#include <deque>
#include <mutex>

#include "common/zenoh/zenoh.hpp"

namespace zloam::zenoh::detail {

/// A ring drops the oldest sample when it is full; a FIFO makes push() wait. After close(), push()
/// does nothing and pop() gives what is left. Any number of threads on both sides.
class Channel {
 public:
  Channel(ChannelKind kind, std::size_t capacity);
  void push(Sample&& sample);
  std::optional<Sample> pop(std::chrono::milliseconds timeout);
  void close();
  std::uint64_t dropped() const;

 private:
  const ChannelKind kind_;
  const std::size_t capacity_;
  mutable std::mutex mutex_;
  std::condition_variable filled_;
  std::condition_variable emptied_;
  std::deque<Sample> samples_;
  std::uint64_t dropped_ = 0;
  bool closed_ = false;
};

}  // namespace zloam::zenoh::detail
