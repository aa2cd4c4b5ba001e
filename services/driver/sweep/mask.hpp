#pragma once
// Points dropped on purpose: the robot's own body, sectors that its parts hide.

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::driver {

/// Degrees clockwise from the sensor's front, both ends included; from above to is a sector through
/// the front.
struct AzimuthSector {
  double from_deg = 0.0;
  double to_deg = 0.0;
  bool contains(double azimuth_deg) const;
};

struct MaskConfig {
  /// points in any of these are dropped
  std::vector<AzimuthSector> sectors = {};
  /// so are points in this box of base_link; empty unless every minimum is below its maximum
  Eigen::Vector3d body_min_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d body_max_m = Eigen::Vector3d::Zero();
  Pose T_base_lidar = Pose::Identity();
};

class PointMask {
 public:
  explicit PointMask(const MaskConfig& config);
  bool active() const { return active_; }
  /// Whether the point (frame lidar) stays.
  bool keeps(const Point& point) const;
  /// Moves the points that stay, with their columns, to the front; returns their number.
  std::size_t apply(Point* points, std::uint16_t* columns, std::size_t count) const;

 private:
  bool in_body(const Point& point) const;

  std::vector<AzimuthSector> sectors_;
  bool body_ = false;
  Eigen::Vector3d body_min_m_;
  Eigen::Vector3d body_max_m_;
  Pose T_base_lidar_;
  bool active_ = false;
};

}  // namespace zloam::driver
