#include "odometry/start.hpp"

#include <algorithm>
#include <cmath>

#include "odometry/degeneracy.hpp"

namespace zloam::odometry {
namespace {

// Share of a revolution that counts as a whole one.
constexpr double kWholeTurn = 0.9;
// Spacing of the starts: with its initial, wide kernel the matching converges from at least half of
// this.
constexpr double kSpacing_m = 0.5;
constexpr double kFastest_mps = 30.0;
// Longest plausible period: no lidar revolves slower than 5 Hz, and a longer period is a fault.
constexpr double kSlowestTurn_s = 0.2;
// Minimum difference of the cost, a log likelihood: e^10 times as likely. Where the direction is
// unobserved, and in foliage, the cost differs by hundredths of itself by chance.
constexpr double kClearly = 10.0;
constexpr double kClearlyPart = 0.025;

std::uint32_t last_time_ns(PointSpan points) {
  std::uint32_t last_ns = 0;
  for (const Point& p : points) {
    if (is_usable(p)) last_ns = std::max(last_ns, p.time_ns);
  }
  return last_ns;
}

}  // namespace

bool covers_turn(const FeatureSweep& sweep) {
  if (sweep.deskewed || sweep.period_ns == 0) return true;
  const std::uint32_t last_ns =
      std::max(last_time_ns(sweep.less_flat), last_time_ns(sweep.less_sharp));
  return last_ns >= kWholeTurn * sweep.period_ns;
}

Solution match_at_any_speed(const Source& source, const MotionState& at_rest,
                            const MotionPrior& prior, double period_s, double range_noise_m,
                            const OdometryConfig& config, WindowMap& recent) {
  Solution best = match_sweep(source, at_rest, prior, range_noise_m, config, recent);
  if (!best.solved) return best;
  const Eigen::Vector3d along = weakest_translation(best.data.H.topLeftCorner<6, 6>());
  if (!along.allFinite()) return best;
  double least = best.cost - std::max(kClearly, kClearlyPart * best.cost);
  const double farthest_m = kFastest_mps * std::min(period_s, kSlowestTurn_s);
  const int reach = static_cast<int>(std::ceil(farthest_m / kSpacing_m));
  for (int i = -reach; i <= reach; ++i) {
    if (i == 0) continue;
    MotionState moving = at_rest;
    moving.T_odom_mid = at_rest.T_odom_mid * Eigen::Translation3d(kSpacing_m * i * along);
    const Solution other = match_sweep(source, moving, prior, range_noise_m, config, recent);
    if (other.solved && other.cost < least) {
      best = other;
      least = other.cost;
    }
  }
  return best;
}

}  // namespace zloam::odometry
