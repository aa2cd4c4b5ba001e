#pragma once
// A-LOAM's mapping: each sweep against the map, and into it.
//
// The sweep's points, averaged in voxels of the map's leaf sizes, are matched against the 5 x 5 x 3
// cubes around the sensor: an edge point against the line of its 5 nearest edge points when all lie
// within 1 m and the largest eigenvalue of their covariance is above 3 times the middle one; a
// plane point against the plane of its 5 nearest plane points when all lie within 1 m of it and 0.2
// m of the plane. Two rounds of matching and solving from where the odometry leads. Every sweep is
// put into the map, and the cubes around the sensor are averaged again, old centroids like new
// points.
//
// Frames: points in base_link at one instant; poses are of base_link at that instant.

#include <cstdint>

#include "aloam/core/cube_map.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::aloam {

/// Leaf sizes of the map, m.
struct Leaves {
  double edge_m = 0.2;
  double plane_m = 0.4;
};

struct Mapped {
  Pose T_map_base = Pose::Identity();
  std::uint32_t lines = 0, planes = 0;
  std::uint32_t iterations = 0;
  double residual_m = 0.0;
  /// false: the map has too few points, or the sweep too few matches, and the pose is where the
  /// odometry leads
  bool matched = false;
};

class ScanToMap {
 public:
  explicit ScanToMap(const Leaves& leaves);

  Mapped process(PointSpan edges, PointSpan planes, const Pose& T_odom_base);
  /// A new odom frame begins, in which the next sweep has this pose: the map goes on from the last
  /// mapped one.
  void continue_from(const Pose& T_odom_base);
  /// The map goes on where another instance left it.
  void restore(const Pose& T_map_base, const Pose& T_map_odom);

  const Pose& T_map_odom() const { return T_map_odom_; }
  const CubeMap& map() const { return map_; }
  CubeMap& map() { return map_; }

 private:
  void match(const Cloud& edges, const Cloud& planes, Mapped& result) const;

  Leaves leaves_;
  CubeMap map_;
  Pose T_map_odom_ = Pose::Identity();
  Pose T_map_base_ = Pose::Identity();
};

}  // namespace zloam::aloam
