#include "mapping/insertion_policy.hpp"

#include <algorithm>
#include <vector>

namespace zloam::mapping {
namespace {

// Minimum number of residuals for a meaningful median.
constexpr std::size_t kFewest = 5;

}  // namespace

double InsertionPolicy::median_residual_m() const {
  if (residuals_.empty()) return 0.0;
  std::vector<double> sorted(residuals_.begin(), residuals_.end());
  const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
  std::nth_element(sorted.begin(), middle, sorted.end());
  return *middle;
}

std::string InsertionPolicy::judge(const Pose& T_map_base, double residual_m) {
  const double median = median_residual_m();
  const bool known = residuals_.size() >= kFewest && median > 0.0;
  residuals_.push_back(residual_m);
  const auto window = static_cast<std::size_t>(std::max(config_.insert_residual_window, 1));
  if (residuals_.size() > window) residuals_.pop_front();
  worse_ = known && residual_m > config_.insert_residual_factor * median ? worse_ + 1 : 0;
  if (worse_ > 0) return "residual above its recent median";
  if (!last_inserted_) return {};
  if (config_.insert_distance_m <= 0.0 && config_.insert_rotation_rad <= 0.0) return {};
  const Vector6 moved = log_se3(last_inserted_->inverse() * T_map_base);
  const bool far =
      config_.insert_distance_m > 0.0 && moved.head<3>().norm() > config_.insert_distance_m;
  const bool turned =
      config_.insert_rotation_rad > 0.0 && moved.tail<3>().norm() > config_.insert_rotation_rad;
  return far || turned ? std::string() : "not moved since the last insertion";
}

}  // namespace zloam::mapping
