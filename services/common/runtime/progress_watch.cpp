#include "common/runtime/progress_watch.hpp"

#include <algorithm>

namespace zloam::runtime {
namespace {

// One may be lost, or come while the instance goes.
constexpr std::size_t kFewest = 3;
// Of one that has shown nothing yet: a great map takes its time to be read.
constexpr std::int64_t kFirst_ns = 30'000'000'000;

}  // namespace

void ProgressWatch::begin() {
  const std::lock_guard lock(mutex_);
  unanswered_ = 0;
  has_worked_ = false;
}

void ProgressWatch::input(std::int64_t now_ns) {
  const std::lock_guard lock(mutex_);
  if (unanswered_++ == 0) unanswered_since_ns_ = now_ns;
}

void ProgressWatch::output() {
  const std::lock_guard lock(mutex_);
  unanswered_ = 0;
  has_worked_ = true;
}

bool ProgressWatch::stalls(std::int64_t now_ns) const {
  const std::lock_guard lock(mutex_);
  const std::int64_t patience_ns = has_worked_ ? stall_ns_ : std::max(stall_ns_, kFirst_ns);
  return unanswered_ >= kFewest && now_ns - unanswered_since_ns_ >= patience_ns;
}

}  // namespace zloam::runtime
