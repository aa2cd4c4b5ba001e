#pragma once
// The points of the sweep before, by nearness and ring (scan_to_scan.hpp).

#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "common/geometry/point.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::aloam {

class RingTarget {
 public:
  /// Points ordered by ring.
  explicit RingTarget(PointSpan points);

  /// Two different points of different rings.
  std::optional<std::array<Eigen::Vector3d, 2>> line_near(const Eigen::Vector3d& point) const;
  /// Three points, not all of one ring: the nearest, one of its own ring or on the far side of it,
  /// one of a ring beyond.
  std::optional<std::array<Eigen::Vector3d, 3>> plane_near(const Eigen::Vector3d& point) const;

 private:
  /// The nearest of those looked at so far.
  class Nearest {
   public:
    void look_at(double squared_m2, std::size_t index) {
      if (squared_m2 >= squared_m2_) return;
      squared_m2_ = squared_m2;
      index_ = index;
    }
    std::optional<std::size_t> index() const { return index_; }

   private:
    double squared_m2_ = kReach_m * kReach_m;
    std::optional<std::size_t> index_;
  };

  std::optional<std::size_t> nearest(const Eigen::Vector3d& point) const;
  double squared_m2(const Eigen::Vector3d& point, std::size_t index) const;
  Eigen::Vector3d at(std::size_t index) const;
  /// Calls visit(index) for the points after (before) this one up to two rings away.
  template <class Visit>
  void after(std::size_t from, const Visit& visit) const;
  template <class Visit>
  void before(std::size_t from, const Visit& visit) const;

  static constexpr double kReach_m = 5.0;
  static constexpr int kRings = 2;

  pcl::PointCloud<pcl::PointXYZ>::Ptr points_;
  std::vector<int> rings_;
  pcl::KdTreeFLANN<pcl::PointXYZ> tree_;
};

}  // namespace zloam::aloam
