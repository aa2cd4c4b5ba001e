#include "mapping/sweep_view.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace zloam::mapping {
namespace {

bool is_nearer(float range_m, float than_m) { return than_m == 0.0F || range_m < than_m; }

}  // namespace

SweepView::SweepView(const MappingInput& input)
    : nearest_m_(static_cast<std::size_t>(kAzimuths) * kElevations, 0.0F) {
  const Eigen::Isometry3f T_lidar_base = input.T_base_lidar.inverse().cast<float>();
  for (const PointSpan layer : {input.edges, input.planes}) {
    for (const Point& p : layer) {
      const Eigen::Vector3f at = T_lidar_base * p.position();
      const float range_m = at.norm();
      if (!(range_m > 0.0F)) continue;
      const Bin bin = bin_of(at / range_m);
      float& nearest_m = nearest_m_[index(bin.azimuth, bin.elevation)];
      if (is_nearer(range_m, nearest_m)) nearest_m = range_m;
    }
  }
}

SweepView::Bin SweepView::bin_of(const Eigen::Vector3f& direction) {
  constexpr float kPi = std::numbers::pi_v<float>;
  const float around = 0.5F + std::atan2(direction.y(), direction.x()) / (2.0F * kPi);
  const float up = 0.5F + std::asin(std::clamp(direction.z(), -1.0F, 1.0F)) / kPi;
  return {std::clamp(static_cast<int>(around * kAzimuths), 0, kAzimuths - 1),
          std::clamp(static_cast<int>(up * kElevations), 0, kElevations - 1)};
}

float SweepView::nearest_m(const Eigen::Vector3f& direction) const {
  const Bin bin = bin_of(direction);
  float nearest_m = 0.0F;
  for (int e = std::max(0, bin.elevation - 1); e <= std::min(kElevations - 1, bin.elevation + 1);
       ++e) {
    for (const int step : {kAzimuths - 1, kAzimuths, kAzimuths + 1}) {
      const float own_m = nearest_m_[index((bin.azimuth + step) % kAzimuths, e)];
      if (own_m > 0.0F && is_nearer(own_m, nearest_m)) nearest_m = own_m;
    }
  }
  return nearest_m;
}

}  // namespace zloam::mapping
