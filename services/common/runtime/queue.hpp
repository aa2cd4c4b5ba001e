#pragma once
// A bounded queue between threads. It never blocks the writer: what does not fit is dropped by the
// queue's policy and handed back to be counted.

#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

namespace zloam::runtime {

enum class QueuePolicy : std::uint8_t {
  kLossless,  ///< refuses the newcomer when full: the bound is a guard for memory, not a policy
  kNewest,    ///< drops the oldest
};

struct QueueBound {
  QueuePolicy policy = QueuePolicy::kLossless;
  std::size_t items = 1024;
  std::size_t bytes = std::size_t{256} << 20;
};

template <class Item>
class BoundedQueue {
 public:
  explicit BoundedQueue(QueueBound bound) : bound_(bound) {}

  /// Takes the item; returns what had to be dropped for it (under kLossless: the item itself). An
  /// item larger than the byte bound alone is dropped under both policies.
  std::vector<Item> push(Item item, std::size_t bytes) {
    const std::lock_guard lock(mutex_);
    std::vector<Item> dropped;
    const auto fits = [&] {
      return entries_.size() < bound_.items && bytes_ + bytes <= bound_.bytes;
    };
    if (bound_.policy == QueuePolicy::kNewest && bytes <= bound_.bytes) {
      while (!fits() && !entries_.empty()) dropped.push_back(take_front());
    }
    if (!fits()) {
      dropped.push_back(std::move(item));
      return dropped;
    }
    entries_.emplace_back(std::move(item), bytes);
    bytes_ += bytes;
    return dropped;
  }

  std::optional<Item> pop() {
    const std::lock_guard lock(mutex_);
    if (entries_.empty()) return std::nullopt;
    return take_front();
  }

  std::size_t size() const {
    const std::lock_guard lock(mutex_);
    return entries_.size();
  }
  std::size_t bytes() const {
    const std::lock_guard lock(mutex_);
    return bytes_;
  }

 private:
  Item take_front() {
    auto [item, bytes] = std::move(entries_.front());
    entries_.pop_front();
    bytes_ -= bytes;
    return std::move(item);
  }

  QueueBound bound_;
  mutable std::mutex mutex_;
  std::deque<std::pair<Item, std::size_t>> entries_;
  std::size_t bytes_ = 0;
};

}  // namespace zloam::runtime
