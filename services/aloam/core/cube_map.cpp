#include "aloam/core/cube_map.hpp"

#include <pcl/filters/voxel_grid.h>

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

namespace zloam::aloam {
namespace {

// Least number of cubes from the sensor's cube to the window's border.
constexpr std::int32_t kMargin = 3;

/// Where the window may begin, inclusive.
struct Begins {
  CubeIndex least, greatest;

  /// Narrows them so that the window holds the cube; false, and unchanged, if it then can't begin
  /// anywhere.
  bool hold(const CubeIndex& cube) {
    Begins narrowed = *this;
    for (std::size_t a = 0; a < 3; ++a) {
      narrowed.least.at[a] = std::max(least.at[a], cube.at[a] + 1 - kWindow[a]);
      narrowed.greatest.at[a] = std::min(greatest.at[a], cube.at[a]);
      if (narrowed.least.at[a] > narrowed.greatest.at[a]) return false;
    }
    *this = narrowed;
    return true;
  }
};

Begins begins_around(const CubeIndex& sensor) {
  Begins begins;
  for (std::size_t a = 0; a < 3; ++a) {
    begins.least.at[a] = sensor.at[a] + kMargin + 1 - kWindow[a];
    begins.greatest.at[a] = sensor.at[a] - kMargin;
  }
  return begins;
}

CubeIndex clamped(const CubeIndex& index, const Begins& begins) {
  CubeIndex result;
  for (std::size_t a = 0; a < 3; ++a) {
    result.at[a] = std::clamp(index.at[a], begins.least.at[a], begins.greatest.at[a]);
  }
  return result;
}

}  // namespace

CubeIndex cube_index(const Eigen::Vector3d& point) {
  CubeIndex index;
  for (std::size_t a = 0; a < 3; ++a) {
    index.at[a] = static_cast<std::int32_t>(std::floor(point[static_cast<int>(a)] / kCube_m));
  }
  return index;
}

Cloud::Ptr voxel_filtered(const Cloud::ConstPtr& points, float leaf_m) {
  Cloud::Ptr out(new Cloud);
  pcl::VoxelGrid<pcl::PointXYZI> grid;
  grid.setInputCloud(points);
  grid.setLeafSize(leaf_m, leaf_m, leaf_m);
  grid.filter(*out);
  return out;
}

CubeMap::CubeMap(double edge_leaf_m, double plane_leaf_m)
    : edge_leaf_m_(static_cast<float>(edge_leaf_m)),
      plane_leaf_m_(static_cast<float>(plane_leaf_m)) {
  for (std::size_t a = 0; a < 3; ++a) first_.at[a] = -(kWindow[a] / 2);
}

bool CubeMap::in_window(const CubeIndex& index) const {
  for (std::size_t a = 0; a < 3; ++a) {
    const std::int32_t offset = index.at[a] - first_.at[a];
    if (offset < 0 || offset >= kWindow[a]) return false;
  }
  return true;
}

bool CubeMap::is_local(const CubeIndex& index) const {
  for (std::size_t a = 0; a < 3; ++a) {
    if (std::abs(index.at[a] - centre_.at[a]) > kLocal[a] / 2) return false;
  }
  return true;
}

void CubeMap::follow(const Eigen::Vector3d& sensor) {
  centre_ = cube_index(sensor);
  const CubeIndex before = std::exchange(first_, clamped(first_, begins_around(centre_)));
  if (first_ != before) forget_outside();
}

void CubeMap::forget_outside() {
  std::erase_if(cubes_, [this](const auto& entry) {
    const auto& [index, cube] = entry;
    if (in_window(index)) return false;
    forgotten_ += cube.edges->size() + cube.planes->size();
    return true;
  });
}

LocalMap CubeMap::local() const {
  LocalMap local;
  for (const auto& [index, cube] : cubes_) {
    if (!is_local(index)) continue;
    *local.edges += *cube.edges;
    *local.planes += *cube.planes;
  }
  return local;
}

Cube* CubeMap::cube_at(const pcl::PointXYZI& point) {
  const CubeIndex index = cube_index(position_of(point));
  if (!in_window(index)) return nullptr;
  changed_.push_back(index);
  return &cubes_[index];
}

void CubeMap::insert(const Cloud& edges, const Cloud& planes) {
  const std::size_t before = changed_.size();
  for (const pcl::PointXYZI& p : edges) {
    if (Cube* cube = cube_at(p)) cube->edges->push_back(p);
  }
  for (const pcl::PointXYZI& p : planes) {
    if (Cube* cube = cube_at(p)) cube->planes->push_back(p);
  }
  ++insertions_;
  const auto added = changed_.begin() + static_cast<std::ptrdiff_t>(before);
  std::sort(added, changed_.end());
  changed_.erase(std::unique(added, changed_.end()), changed_.end());
  for (auto at = changed_.begin() + static_cast<std::ptrdiff_t>(before); at != changed_.end();
       ++at) {
    cubes_[*at].version = insertions_;
  }
}

void CubeMap::filter_local() {
  for (auto& [index, cube] : cubes_) {
    if (!is_local(index)) continue;
    cube.edges = voxel_filtered(cube.edges, edge_leaf_m_);
    cube.planes = voxel_filtered(cube.planes, plane_leaf_m_);
  }
}

void CubeMap::lay_window(const Eigen::Vector3d& sensor) {
  std::vector<std::pair<std::uint64_t, CubeIndex>> newest_last;
  for (const auto& [index, cube] : cubes_) newest_last.emplace_back(cube.version, index);
  std::ranges::sort(newest_last);
  Begins begins = begins_around(cube_index(sensor));
  for (auto at = newest_last.rbegin(); at != newest_last.rend(); ++at) begins.hold(at->second);
  first_ = clamped(first_, begins);
}

void CubeMap::restore(std::map<CubeIndex, Cube> cubes, const Eigen::Vector3d& sensor) {
  cubes_ = std::move(cubes);
  for (const auto& [index, cube] : cubes_) insertions_ = std::max(insertions_, cube.version);
  lay_window(sensor);
  forget_outside();
  follow(sensor);
}

std::size_t CubeMap::point_count() const {
  std::size_t count = 0;
  for (const auto& [index, cube] : cubes_) count += cube.edges->size() + cube.planes->size();
  return count;
}

std::vector<CubeIndex> CubeMap::take_changed() {
  std::vector<CubeIndex> changed = std::exchange(changed_, {});
  std::ranges::sort(changed);
  changed.erase(std::unique(changed.begin(), changed.end()), changed.end());
  return changed;
}

}  // namespace zloam::aloam
