#pragma once
// How long the motion of the platform went unobserved between two mapped sweeps.

#include <algorithm>
#include <cstdint>
#include <optional>

namespace zloam::mapping {

/// The odometry's steps from the pose seen before to this one: it names the sweep before each, so
/// that poses which mapping was too slow to take are told from sweeps that the odometry lacked too.
inline double steps_since(std::uint64_t before, std::uint64_t sweep, std::uint64_t prev_sweep) {
  const bool none_between = prev_sweep <= before || sweep <= before;
  return none_between ? 1.0 : static_cast<double>(sweep - before);
}

/// Sees each odometry pose that arrives, mapped or not.
class OdometryWatch {
 public:
  void see(std::uint64_t sweep, std::uint64_t prev_sweep, std::int64_t instant_ns) {
    if (before_) {
      const double since_s = 1e-9 * static_cast<double>(instant_ns - before_->instant_ns);
      longest_s_ = std::max(longest_s_, since_s / steps_since(before_->sweep, sweep, prev_sweep));
    } else {
      is_known_ = false;
    }
    before_ = Seen{sweep, instant_ns};
  }
  /// The longest time without odometry since the last call, s; nothing: unknown, as this run's
  /// first sweep is among them.
  std::optional<double> take() {
    const std::optional<double> longest_s = is_known_ ? std::optional(longest_s_) : std::nullopt;
    longest_s_ = 0.0;
    is_known_ = true;
    return longest_s;
  }

 private:
  struct Seen {
    std::uint64_t sweep;
    std::int64_t instant_ns;
  };
  std::optional<Seen> before_;
  double longest_s_ = 0.0;
  bool is_known_ = true;
};

}  // namespace zloam::mapping
