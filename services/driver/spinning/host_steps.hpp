#pragma once
// Steps of the host's clock. Lines keep an even time base, which no step moves; the motor's
// readings are stamped by the host's clock and are moved to that base as they arrive.

#include <cstdint>
#include <utility>

namespace zloam::driver::spinning {

class HostSteps {
 public:
  /// ahead_ns: of the host's clock against the even time base, at now_ns of that base.
  void look(std::int64_t ahead_ns, std::int64_t now_ns);
  /// Moves the stamp of a reading that arrives at now_ns of the even time base. Takes readings in
  /// order: those stamped before a step may arrive after it.
  std::int64_t even_ns(std::int64_t stamp_ns, std::int64_t now_ns);

  /// What the host's clock was set by since the base began, and in how many steps.
  std::int64_t ahead_ns() const { return ahead_ns_; }
  std::uint64_t count() const { return count_; }
  /// The part of it since the last call.
  std::int64_t take_step_ns() { return std::exchange(step_ns_, 0); }

 private:
  std::int64_t ahead_ns_ = 0;
  /// before the last step
  std::int64_t before_ns_ = 0;
  /// of the even time base, when the last step was seen
  std::int64_t stepped_ns_ = 0;
  /// a reading stamped after the last step has arrived
  bool passed_ = true;
  std::int64_t step_ns_ = 0;
  std::uint64_t count_ = 0;
};

}  // namespace zloam::driver::spinning
