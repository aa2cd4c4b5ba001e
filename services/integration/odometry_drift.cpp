#include "integration/odometry_drift.hpp"

#include <cmath>

#include "common/geometry/health.hpp"

namespace zloam::integration {
namespace {

// Way between the places that are kept: enough of them for ten metres, and few to save.
constexpr double kBetween_m = 0.5;

}  // namespace

void OdometryDrift::forget() { *this = OdometryDrift(); }

void OdometryDrift::add(const Pose& T_map_base, const Pose& T_odom_base,
                        const Eigen::Matrix3d& covariance_m2) {
  // Its trace is never below the variance along any direction.
  Place now{T_map_base, T_odom_base, covariance_m2.trace(), 0.0};
  if (last_) {
    now.way_m = last_->way_m + (T_map_base.translation() - last_->T_map_base.translation()).norm();
  }
  if (kept_.empty() || now.way_m - kept_.back().way_m >= kBetween_m) kept_.push_back(now);
  while (kept_.size() > 2 && now.way_m - kept_[1].way_m >= kJudgedWay_m) kept_.pop_front();
  last_ = now;
}

double OdometryDrift::drift_m() const {
  if (!last_) return 0.0;
  const Place& then = kept_.front();
  const Pose by_map = then.T_map_base.inverse() * last_->T_map_base;
  const Pose by_odometry = then.T_odom_base.inverse() * last_->T_odom_base;
  return (by_map.inverse() * by_odometry).translation().norm();
}

double OdometryDrift::way_m() const { return last_ ? last_->way_m - kept_.front().way_m : 0.0; }

bool OdometryDrift::exceeds(double limit_m) const {
  if (!last_) return false;
  const double variance_m2 = kept_.front().variance_m2 + last_->variance_m2;
  return drift_m() > limit_m + 3.0 * std::sqrt(variance_m2);
}

}  // namespace zloam::integration
