#include "driver/sweep/mask.hpp"

#include <cmath>
#include <numbers>

namespace zloam::driver {

bool AzimuthSector::contains(double azimuth_deg) const {
  if (from_deg <= to_deg) return azimuth_deg >= from_deg && azimuth_deg <= to_deg;
  return azimuth_deg >= from_deg || azimuth_deg <= to_deg;
}

PointMask::PointMask(const MaskConfig& config)
    : sectors_(config.sectors),
      body_((config.body_min_m.array() < config.body_max_m.array()).all()),
      body_min_m_(config.body_min_m),
      body_max_m_(config.body_max_m),
      T_base_lidar_(config.T_base_lidar),
      active_(body_ || !sectors_.empty()) {}

bool PointMask::in_body(const Point& point) const {
  const Eigen::Vector3d p_base = T_base_lidar_ * point.position().cast<double>();
  return (p_base.array() >= body_min_m_.array()).all() &&
         (p_base.array() <= body_max_m_.array()).all();
}

bool PointMask::keeps(const Point& point) const {
  if (body_ && in_body(point)) return false;
  if (sectors_.empty()) return true;
  double azimuth_deg = std::atan2(-static_cast<double>(point.y), static_cast<double>(point.x)) *
                       180.0 / std::numbers::pi;
  if (azimuth_deg < 0.0) azimuth_deg += 360.0;
  for (const AzimuthSector& sector : sectors_) {
    if (sector.contains(azimuth_deg)) return false;
  }
  return true;
}

std::size_t PointMask::apply(Point* points, std::uint16_t* columns, std::size_t count) const {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < count; ++i) {
    if (!keeps(points[i])) continue;
    points[kept] = points[i];
    columns[kept++] = columns[i];
  }
  return kept;
}

}  // namespace zloam::driver
