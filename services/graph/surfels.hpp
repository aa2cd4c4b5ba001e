#pragma once
// A submap as surfaces: voxels of two sizes, each with the mean of its points and, where they lie in
// one, the normal of their plane. A tenth of the points' memory, and ready to be matched to and to
// be matched.

#include <Eigen/Core>
#include <span>
#include <vector>

#include "common/containers/flat_index.hpp"

namespace zloam::graph {

struct Surfel {
  Eigen::Vector3f centre = Eigen::Vector3f::Zero();
  /// unit; zero: the points lie in no plane
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();

  bool is_plane() const { return !normal.isZero(0.0F); }
};

/// Voxels of one size, in the order in which they were first hit.
class SurfelGrid {
 public:
  /// points: z up. thickness_m: of a plane, one sigma at most.
  SurfelGrid(std::span<const Eigen::Vector3f> points, double edge_m, double thickness_m);

  /// Of the voxel that holds the point; nullptr: nothing was seen there.
  const Surfel* at(const Eigen::Vector3f& point) const;
  const std::vector<Surfel>& surfels() const { return surfels_; }

 private:
  double edge_m_;
  FlatIndex index_;
  std::vector<Surfel> surfels_;
};

/// Coarse planes first, as they draw from farther off.
struct Surfaces {
  SurfelGrid coarse, fine;

  explicit Surfaces(std::span<const Eigen::Vector3f> points);
  /// A plane where there is one; nullptr: nothing was seen there.
  const Surfel* at(const Eigen::Vector3f& point) const;
};

}  // namespace zloam::graph
