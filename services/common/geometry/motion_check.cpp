#include "common/geometry/motion_check.hpp"

#include <algorithm>
#include <cmath>

namespace zloam {
namespace {

// Consistent poses in a row that are accepted after all: two seconds of a lidar at 10 Hz.
constexpr int kBelievedAfter = 20;
constexpr double kLongest_s = 3600.0;
// Poses of two publishers, or of a restarted one, may overlap in time by this much.
constexpr double kBack_s = -10.0;
// Longer gaps count as this long: the reachable distance does not grow further.
constexpr double kCounted_s = 10.0;

std::string fixed(double value) {
  return std::to_string(static_cast<long long>(std::llround(std::min(value, 1e15))));
}

}  // namespace

std::string MotionCheck::error(const Entry& from, const Entry& to, const Pose& at) const {
  if (from.frame != to.frame) return {};
  const double gap_s =
      1e-9 * (static_cast<double>(to.instant_ns) - static_cast<double>(from.instant_ns));
  if (gap_s < kBack_s || gap_s > kLongest_s) {
    return "its instant is " + fixed(std::abs(gap_s)) + " s from the last accepted one's";
  }
  // The gap is negative when a delayed pose arrives after later ones.
  const double time_s = std::min(std::abs(gap_s), kCounted_s);
  const Pose step = (from.pose * at).inverse() * (to.pose * at);
  const double moved_m = step.translation().norm();
  const double turned_rad = Eigen::AngleAxisd(step.linear()).angle();
  if (!(moved_m <= reach_.m + reach_.m_per_s * time_s)) {
    return "it is " + fixed(moved_m) + " m from the last accepted one";
  }
  if (!(turned_rad <= reach_.rad + reach_.rad_per_s * time_s)) {
    return "it is rotated by " + fixed(180.0 / M_PI * turned_rad) +
           " degrees from the last accepted one";
  }
  return {};
}

std::string MotionCheck::check(std::uint64_t frame, std::int64_t instant_ns, const Pose& pose,
                               const Pose& at) {
  const Entry entry{frame, instant_ns, pose};
  std::string why = accepted_ ? error(*accepted_, entry, at) : std::string();
  if (!why.empty()) {
    const bool fits = refused_ && error(*refused_, entry, at).empty();
    refused_in_a_row_ = fits ? refused_in_a_row_ + 1 : 1;
    refused_ = entry;
    if (refused_in_a_row_ < kBelievedAfter) return why;
  }
  accepted_ = entry;
  refused_.reset();
  refused_in_a_row_ = 0;
  return {};
}

}  // namespace zloam
