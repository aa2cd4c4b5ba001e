#include "odometry/imu_integration.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

namespace zloam::odometry {
namespace {

// Longest gap between two readings, and at either end of the sweep, in median periods.
constexpr double kLongestGap = 3.0;
constexpr std::size_t kLeastReadings = 3;

// A reading in base_link's axes with its errors removed; time since the sweep's begin.
struct Inertia {
  double time_s = 0.0;
  Eigen::Vector3d force, rate;
};

std::vector<Inertia> in_base(ImuSpan readings, std::int64_t stamp_ns, const Pose& T_base_imu,
                             const ImuErrors& errors) {
  std::vector<Inertia> out;
  out.reserve(readings.size());
  const Eigen::Matrix3d R = T_base_imu.linear();
  for (const ImuReading& r : readings) {
    const double time_s = 1e-9 * static_cast<double>(r.stamp_ns - stamp_ns) - errors.delay_s;
    if (!r.force_mps2.allFinite() || !r.rate_radps.allFinite()) continue;
    if (!out.empty() && time_s <= out.back().time_s) continue;
    out.push_back(
        {time_s, R * r.force_mps2 - errors.force_mps2, R * r.rate_radps - errors.rate_radps});
  }
  return out;
}

bool covers(const std::vector<Inertia>& readings, double period_s) {
  if (readings.size() < kLeastReadings) return false;
  std::vector<double> gaps;
  double longest = 0.0;
  for (std::size_t i = 1; i < readings.size(); ++i) {
    const double begin_s = readings[i - 1].time_s;
    const double end_s = readings[i].time_s;
    gaps.push_back(end_s - begin_s);
    if (end_s > 0.0 && begin_s < period_s) longest = std::max(longest, gaps.back());
  }
  const auto middle = gaps.begin() + static_cast<std::ptrdiff_t>(gaps.size() / 2);
  std::nth_element(gaps.begin(), middle, gaps.end());
  const double most_s = kLongestGap * *middle;
  return longest <= most_s && readings.front().time_s <= most_s &&
         readings.back().time_s >= period_s - most_s;
}

// Interpolates linearly between readings; constant before the first and after the last one.
Inertia at(const std::vector<Inertia>& readings, double time_s) {
  const auto after = std::lower_bound(readings.begin(), readings.end(), time_s,
                                      [](const Inertia& r, double t) { return r.time_s < t; });
  if (after == readings.begin()) return readings.front();
  if (after == readings.end()) return readings.back();
  const Inertia& a = *(after - 1);
  const double share = (time_s - a.time_s) / (after->time_s - a.time_s);
  return {time_s, a.force + share * (after->force - a.force),
          a.rate + share * (after->rate - a.rate)};
}

double spread(const std::vector<Inertia>& readings) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Inertia& r : readings) mean += r.force;
  mean /= static_cast<double>(readings.size());
  double sum = 0.0;
  for (const Inertia& r : readings) sum += (r.force - mean).squaredNorm();
  return std::sqrt(sum / (3.0 * static_cast<double>(readings.size())));
}

// Integrals from the sweep's begin on.
struct Integral {
  double time_s = 0.0;
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d way = Eigen::Vector3d::Zero();

  // Integrates one step with the rate and force at its middle.
  void advance(const std::vector<Inertia>& readings, double until_s) {
    const double dt = until_s - time_s;
    if (dt <= 0.0) return;
    const Inertia middle = at(readings, time_s + 0.5 * dt);
    const Eigen::Vector3d force = turn * exp_so3(0.5 * dt * middle.rate) * middle.force;
    way += dt * velocity + 0.5 * dt * dt * force;
    velocity += dt * force;
    turn = turn * exp_so3(dt * middle.rate);
    time_s = until_s;
  }

  void advance_through(const std::vector<Inertia>& readings, double until_s) {
    for (const Inertia& r : readings) {
      if (r.time_s > time_s && r.time_s < until_s) advance(readings, r.time_s);
    }
    advance(readings, until_s);
  }
};

}  // namespace

std::optional<SweepInertia> integrate(ImuSpan readings, std::int64_t stamp_ns,
                                      std::uint32_t period_ns, const Pose& T_base_imu,
                                      const ImuErrors& errors) {
  const double period_s = 1e-9 * period_ns;
  const std::vector<Inertia> inertia = in_base(readings, stamp_ns, T_base_imu, errors);
  if (period_ns == 0 || !covers(inertia, period_s)) return std::nullopt;
  Integral sum;
  sum.advance_through(inertia, 0.5 * period_s);
  const Eigen::Matrix3d half = sum.turn;
  sum.advance_through(inertia, period_s);

  const Eigen::Vector3d arm = T_base_imu.translation();
  const Eigen::Vector3d swing_begin = at(inertia, 0.0).rate.cross(arm);
  const Eigen::Vector3d swing_end = at(inertia, period_s).rate.cross(arm);
  const Eigen::Vector3d swing_mean = (sum.turn * arm - arm) / period_s;
  const Eigen::Vector3d mean = sum.way / period_s;
  SweepInertia out;
  out.period_s = period_s;
  out.turn_rad = log_so3(sum.turn);
  // The second half's rotation minus the first half's is a quarter of the rate's change over the
  // sweep.
  out.bend_rad = 4.0 * (log_so3(half.transpose() * sum.turn) - log_so3(half));
  out.begin_to_mean_mps = mean + swing_begin - swing_mean;
  out.mean_to_end_mps = sum.turn.transpose() * (sum.velocity - mean + swing_mean) - swing_end;
  out.mean_force_mps2 = sum.velocity / period_s;
  out.mean_force_from_end_mps2 = sum.turn.transpose() * out.mean_force_mps2;
  out.force_spread_mps2 = spread(inertia);
  return out;
}

}  // namespace zloam::odometry
