#pragma once
// A-LOAM's map: edge and plane points in cubes of 50 m, at most 21 x 21 x 11 of them around the
// sensor. Cubes near the border move the window; what leaves it is forgotten, as there.
//
// Cube (i, j, k) spans [i, i + 1) * 50 m, as the messages have it; A-LOAM's lie half a cube off.

#include <array>
#include <compare>
#include <cstdint>
#include <map>
#include <vector>

#include "aloam/core/clouds.hpp"

namespace zloam::aloam {

struct CubeIndex {
  std::array<std::int32_t, 3> at{};
  auto operator<=>(const CubeIndex&) const = default;
};

inline constexpr double kCube_m = 50.0;
inline constexpr std::array<std::int32_t, 3> kWindow = {21, 21, 11};
inline constexpr std::array<std::int32_t, 3> kLocal = {5, 5, 3};

/// Points in the order in which PCL's voxel filter leaves them.
struct Cube {
  Cloud::Ptr edges{new Cloud};
  Cloud::Ptr planes{new Cloud};
  /// of the whole map, so that a cube that was forgotten and is seen again is newer than before:
  /// the number of the last insertion that added points
  std::uint64_t version = 0;
};

struct LocalMap {
  Cloud::Ptr edges{new Cloud};
  Cloud::Ptr planes{new Cloud};
};

class CubeMap {
 public:
  CubeMap(double edge_leaf_m, double plane_leaf_m);

  /// Moves the window so that the sensor is at least three cubes from its border.
  void follow(const Eigen::Vector3d& sensor);
  /// All points of the 5 x 5 x 3 cubes around the last position.
  LocalMap local() const;
  /// Points, frame map, into their cubes; outside the window they are lost.
  void insert(const Cloud& edges, const Cloud& planes);
  /// One point a voxel again in each of the 5 x 5 x 3 cubes: the centroid of what is there.
  void filter_local();
  /// Puts the cubes of another instance back, with the sensor where it left it. The window is laid
  /// around them: of more than fit, the newest stay.
  void restore(std::map<CubeIndex, Cube> cubes, const Eigen::Vector3d& sensor);

  const std::map<CubeIndex, Cube>& cubes() const { return cubes_; }
  bool is_local(const CubeIndex& index) const;
  std::size_t point_count() const;
  /// Points in cubes that have left the window.
  std::uint64_t forgotten() const { return forgotten_; }
  /// Cubes that have changed since the last call, ascending.
  std::vector<CubeIndex> take_changed();

 private:
  bool in_window(const CubeIndex& index) const;
  Cube* cube_at(const pcl::PointXYZI& point);
  void lay_window(const Eigen::Vector3d& sensor);
  void forget_outside();

  float edge_leaf_m_, plane_leaf_m_;
  CubeIndex centre_, first_;
  std::map<CubeIndex, Cube> cubes_;
  std::vector<CubeIndex> changed_;
  std::uint64_t insertions_ = 0;
  std::uint64_t forgotten_ = 0;
};

CubeIndex cube_index(const Eigen::Vector3d& point);
/// PCL's voxel filter, the leaf a cube.
Cloud::Ptr voxel_filtered(const Cloud::ConstPtr& points, float leaf_m);

}  // namespace zloam::aloam
