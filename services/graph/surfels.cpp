#include "graph/surfels.hpp"

#include "common/geometry/floor.hpp"
#include "common/geometry/grid_key.hpp"
#include "common/plane_map/moments.hpp"

namespace zloam::graph {
namespace {

constexpr double kCoarse_m = 2.0, kFine_m = 1.0;
// Maximum thickness of a plane, one sigma: noise and distortion of the submap.
constexpr double kThickness_m = 0.06;
constexpr double kFewest = 6.0, kAspect = 9.0;
// Minimum width of a plane across its narrower side, one sigma, in edges of the voxel.
constexpr double kWidth = 0.1;

std::uint64_t key_of(const Eigen::Vector3f& p, double edge_m) {
  const auto cell = [&](int axis) {
    return floor_to<std::int64_t>(static_cast<double>(p[axis]) / edge_m);
  };
  return grid_key(cell(0), cell(1), cell(2));
}

Surfel surfel_of(const plane_map::Moments& moments, const Eigen::Vector3f& origin, double width_m,
                 double thickness_m) {
  Surfel surfel;
  const Eigen::Vector3d mean = moments.mean();
  surfel.centre = origin + mean.cast<float>();
  if (moments.count < kFewest) return surfel;
  const plane_map::PrincipalAxes axes = plane_map::principal_axes(moments);
  const Eigen::Vector3d& variances = axes.variances;
  const bool thin = variances[0] < thickness_m * thickness_m && variances[1] > width_m * width_m &&
                    variances[1] > kAspect * variances[0];
  if (thin) surfel.normal = axes.axes.col(0).cast<float>();
  return surfel;
}

}  // namespace

SurfelGrid::SurfelGrid(std::span<const Eigen::Vector3f> points, double edge_m, double thickness_m)
    : edge_m_(edge_m) {
  struct Sums {
    Eigen::Vector3f origin;
    unsigned count = 0;
    plane_map::MomentSums<double> sums;
  };
  std::vector<Sums> voxels;
  for (const Eigen::Vector3f& p : points) {
    const std::uint64_t key = key_of(p, edge_m);
    std::uint32_t place = index_.find(key);
    if (place == FlatIndex::kNone) {
      place = static_cast<std::uint32_t>(voxels.size());
      index_.insert(key, place);
      voxels.push_back({p, 0, {}});
    }
    Sums& voxel = voxels[place];
    const Eigen::Vector3f off = p - voxel.origin;
    voxel.sums.add(off.x(), off.y(), off.z());
    ++voxel.count;
  }
  surfels_.reserve(voxels.size());
  for (const Sums& voxel : voxels) {
    surfels_.push_back(surfel_of(plane_map::Moments(voxel.count, voxel.sums), voxel.origin,
                                 kWidth * edge_m, thickness_m));
  }
}

const Surfel* SurfelGrid::at(const Eigen::Vector3f& point) const {
  const std::uint32_t place = index_.find(key_of(point, edge_m_));
  return place == FlatIndex::kNone ? nullptr : &surfels_[place];
}

Surfaces::Surfaces(std::span<const Eigen::Vector3f> points)
    : coarse(points, kCoarse_m, kThickness_m), fine(points, kFine_m, kThickness_m) {}

const Surfel* Surfaces::at(const Eigen::Vector3f& point) const {
  const Surfel* found = coarse.at(point);
  if (!found || found->is_plane()) return found;
  return fine.at(point);
}

}  // namespace zloam::graph
