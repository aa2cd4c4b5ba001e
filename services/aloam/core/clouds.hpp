#pragma once
// PCL's types as A-LOAM's stages use them, and the way from and to the messages' points.

#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::aloam {

/// A return within one ring: `intensity` is the reflectance, `curvature` the time since the sweep's
/// first point, ns, so that PCL's voxel filter averages both. A-LOAM packs ring and time into the
/// intensity instead.
using TimedPoint = pcl::PointXYZINormal;
using TimedCloud = pcl::PointCloud<TimedPoint>;

/// A point of the map, and of a sweep on its way there.
using Cloud = pcl::PointCloud<pcl::PointXYZI>;

inline TimedPoint timed_point(const Point& p) {
  TimedPoint out;
  out.x = p.x;
  out.y = p.y;
  out.z = p.z;
  out.intensity = p.intensity;
  out.curvature = static_cast<float>(p.time_ns);
  return out;
}

inline Point point_of(const TimedPoint& p, std::uint16_t ring) {
  return {p.x,
          p.y,
          p.z,
          p.intensity,
          static_cast<std::uint32_t>(p.curvature),
          ring,
          ReturnType::kStrongest,
          0};
}

inline pcl::PointXYZI map_point(float x, float y, float z, float intensity) {
  pcl::PointXYZI out;
  out.x = x;
  out.y = y;
  out.z = z;
  out.intensity = intensity;
  return out;
}

template <class P>
Eigen::Vector3d position_of(const P& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

/// The same point elsewhere.
template <class P>
P moved(P p, const Pose& T) {
  const Eigen::Vector3d q = T * position_of(p);
  p.x = static_cast<float>(q.x());
  p.y = static_cast<float>(q.y());
  p.z = static_cast<float>(q.z());
  return p;
}

}  // namespace zloam::aloam
