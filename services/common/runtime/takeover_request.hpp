#pragma once
// A get of `command/<stage>/takeover/<instance>` from its arrival on one of Zenoh's threads until
// the stage's worker answers it. A newer one replaces it.

#include <mutex>
#include <optional>
#include <utility>

#include "common/zenoh/zenoh.hpp"

namespace zloam::runtime {

class TakeoverRequest {
 public:
  void set(zenoh::Query&& query) {
    const std::lock_guard lock(mutex_);
    query_.emplace(std::move(query));
  }
  std::optional<zenoh::Query> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(query_, std::nullopt);
  }

 private:
  std::mutex mutex_;
  std::optional<zenoh::Query> query_;
};

}  // namespace zloam::runtime
