#pragma once
// A submap as surfaces: voxels of two sizes, each with the mean of its points and, if they are
// coplanar, the normal of their plane. A tenth of the points' memory, usable on both sides of a
// match.

#include <Eigen/Core>
#include <span>
#include <vector>

#include "common/containers/flat_index.hpp"

namespace zloam::graph {

struct Surfel {
  Eigen::Vector3f centre = Eigen::Vector3f::Zero();
  /// unit; zero: the points are not coplanar
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();

  bool is_plane() const { return !normal.isZero(0.0F); }
};

/// Voxels of one size, in the order in which they were first hit.
class SurfelGrid {
 public:
  /// points: z up. thickness_m: maximum of a plane, one sigma.
  SurfelGrid(std::span<const Eigen::Vector3f> points, double edge_m, double thickness_m);

  /// The surfel of the voxel that holds the point; nullptr: nothing was seen there.
  const Surfel* at(const Eigen::Vector3f& point) const;
  const std::vector<Surfel>& surfels() const { return surfels_; }

 private:
  double edge_m_;
  FlatIndex index_;
  std::vector<Surfel> surfels_;
};

/// Coarse planes first, as they attract from farther away.
struct Surfaces {
  SurfelGrid coarse, fine;

  explicit Surfaces(std::span<const Eigen::Vector3f> points);
  /// A plane if there is one; nullptr: nothing was seen there.
  const Surfel* at(const Eigen::Vector3f& point) const;
};

}  // namespace zloam::graph
