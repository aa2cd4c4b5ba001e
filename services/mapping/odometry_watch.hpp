#pragma once
// How long the motion of the platform went unobserved between two mapped sweeps.

#include <algorithm>
#include <cstdint>
#include <optional>

namespace zloam::mapping {

/// Sees each odometry pose that arrives, mapped or not. Poses that mapping was too slow to take are
/// missing here, but not in the odometry, which names the sweep before each.
class OdometryWatch {
 public:
  void see(std::uint64_t sweep, std::uint64_t prev_sweep, std::int64_t instant_ns) {
    if (before_) {
      const double since_s = 1e-9 * static_cast<double>(instant_ns - before_->instant_ns);
      const bool none_between = prev_sweep <= before_->sweep || sweep <= before_->sweep;
      const double steps = none_between ? 1.0 : static_cast<double>(sweep - before_->sweep);
      longest_s_ = std::max(longest_s_, since_s / steps);
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
