#include "mapping/voxel_filter.hpp"

#include "common/containers/flat_index.hpp"
#include "mapping/grid_index.hpp"

namespace zloam::mapping {
namespace {

constexpr float kFarthest_m = 1e5F;

std::uint64_t voxel_key(const Eigen::Vector3f& p, double leaf_m) {
  return pack_key(grid_index(p.cast<double>(), leaf_m));
}

}  // namespace

std::vector<Eigen::Vector3d> voxel_means(PointSpan points, double leaf_m) {
  std::vector<Eigen::Vector3d> means;
  std::vector<double> counts;
  FlatIndex index(2 * points.size());
  for (const Point& point : points) {
    const Eigen::Vector3f p = point.position();
    if (!p.allFinite() || p.cwiseAbs().maxCoeff() > kFarthest_m) continue;
    const std::uint64_t key = leaf_m > 0.0 ? voxel_key(p, leaf_m) : 0;
    std::uint32_t slot = leaf_m > 0.0 ? index.find(key) : FlatIndex::kNone;
    if (slot == FlatIndex::kNone) {
      slot = static_cast<std::uint32_t>(means.size());
      if (leaf_m > 0.0) index.insert(key, slot);
      means.emplace_back(Eigen::Vector3d::Zero());
      counts.push_back(0.0);
    }
    means[slot] += p.cast<double>();
    counts[slot] += 1.0;
  }
  for (std::size_t i = 0; i < means.size(); ++i) means[i] /= counts[i];
  return means;
}

}  // namespace zloam::mapping
