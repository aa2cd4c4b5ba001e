#include "common/runtime/progress_watch.hpp"

#include <algorithm>

namespace zloam::runtime {
namespace {

// Unanswered sweeps before an instance counts as stalled: one may be lost, or arrive while the
// instance ends.
constexpr std::size_t kFewest = 3;
// Time allowed for an instance's first output: reading a large map takes long.
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
