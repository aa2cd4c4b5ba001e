#pragma once
// Lines and planes through points of the sweep before: the target of Target::kLastSweep, as in LOAM
// (Zhang and Singh, RSS 2014, section V-B). A line goes through the nearest edge point and another
// one on a ring nearby; a plane through the nearest flat point, another of its ring, and one of a
// ring nearby. Points are kept by ring and azimuth, so that "the nearest on ring k" is a look-up in
// a few bins; no tree is built.

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"
#include "odometry/config.hpp"

namespace zloam::odometry {

/// Points of one cloud by ring and azimuth about the lidar's axis.
class RingIndex {
 public:
  /// points: frame lidar at one instant, ordered by ring. Successive points of a ring within leaf_m
  /// are averaged; 0 keeps all.
  void build(PointSpan points, double leaf_m);

  /// The point of a ring nearest to the query (frame lidar) within radius_m, other than `except`
  /// (an index, or -1); -1 when there is none. Of equals the first.
  int nearest(const Eigen::Vector3f& query, int ring, float radius_m, int except = -1) const;

  int rings() const { return rings_; }
  const Eigen::Vector3f& position(int index) const {
    return positions_[static_cast<std::size_t>(index)];
  }
  bool empty() const { return positions_.empty(); }

 private:
  static constexpr int kBins = 360;
  int bin_of(const Eigen::Vector3f& p) const;

  int rings_ = 0;
  std::vector<Eigen::Vector3f> positions_;  // by (ring, bin), then in the cloud's order
  std::vector<std::uint32_t> bin_begin_;    // rings * kBins + 1
};

struct TargetLine {
  Eigen::Vector3d point, direction;  ///< frame odom, direction unit
};
struct TargetPlane {
  Eigen::Vector3d normal;  ///< unit, frame odom
  double offset;
};

class RingTarget {
 public:
  explicit RingTarget(const OdometryConfig& config) : config_(config) {}

  /// edges and planes: frame base_link at one instant, with the pose at that instant.
  void set(PointSpan edges, PointSpan planes, const Pose& T_odom_base, const Pose& T_base_lidar);
  bool empty() const { return edges_.empty() && planes_.empty(); }
  void clear();

  std::optional<TargetLine> line(const Eigen::Vector3d& point_odom) const;
  std::optional<TargetPlane> plane(const Eigen::Vector3d& point_odom) const;

 private:
  struct Match {
    int index = -1;
    int ring = -1;
  };
  Match nearest_of_all(const RingIndex& index, const Eigen::Vector3f& query) const;
  int nearest_of_others(const RingIndex& index, const Eigen::Vector3f& query, int ring) const;

  OdometryConfig config_;
  Pose T_odom_lidar_ = Pose::Identity();
  Pose T_lidar_odom_ = Pose::Identity();
  RingIndex edges_;
  RingIndex planes_;
};

}  // namespace zloam::odometry
