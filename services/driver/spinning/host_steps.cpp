#include "driver/spinning/host_steps.hpp"

#include <cstdlib>

namespace zloam::driver::spinning {
namespace {

// Both clocks run at one rate, so that a smaller change is an error of reading them.
constexpr std::int64_t kLeastStepNs = 1'000'000;
// No reading takes longer to arrive.
constexpr std::int64_t kLongestDelayNs = 1'000'000'000;

}  // namespace

void HostSteps::look(std::int64_t ahead_ns, std::int64_t now_ns) {
  const std::int64_t step_ns = ahead_ns - ahead_ns_;
  if (std::abs(step_ns) < kLeastStepNs) return;
  before_ns_ = ahead_ns_;
  ahead_ns_ = ahead_ns;
  passed_ = false;
  stepped_ns_ = now_ns;
  step_ns_ += step_ns;
  ++count_;
}

std::int64_t HostSteps::even_ns(std::int64_t stamp_ns, std::int64_t now_ns) {
  const std::int64_t after_ns = stamp_ns - ahead_ns_;
  if (passed_) return after_ns;
  // Stamped before the last step or after it: a reading is not from the future, and arrives soon.
  const std::int64_t before_ns = stamp_ns - before_ns_;
  // Of a step that is shorter than the delay, no reading tells this, but the time does.
  const bool may_be = before_ns <= now_ns && now_ns - stepped_ns_ <= kLongestDelayNs;
  const bool is_before = may_be && (after_ns > now_ns || before_ns > after_ns);
  passed_ = !is_before;
  return is_before ? before_ns : after_ns;
}

}  // namespace zloam::driver::spinning
