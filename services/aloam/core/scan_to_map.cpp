#include "aloam/core/scan_to_map.hpp"

#include <pcl/kdtree/kdtree_flann.h>

#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "aloam/core/cost_functions.hpp"
#include "aloam/core/motion_problem.hpp"

namespace zloam::aloam {
namespace {

constexpr int kRounds = 2;
constexpr int kNeighbours = 5;
constexpr float kReach_m2 = 1.0F;
constexpr double kLineRatio = 3.0;
constexpr double kPlane_m = 0.2;
// Distance of a line's two points from its centre.
constexpr double kLineHalf_m = 0.1;
constexpr std::size_t kFewestEdges = 10;
constexpr std::size_t kFewestPlanes = 50;

using Neighbours = Eigen::Matrix<double, kNeighbours, 3>;

class NearestPoints {
 public:
  explicit NearestPoints(const Cloud::Ptr& points) : points_(points) {
    tree_.setInputCloud(points);
  }

  /// Nothing if fewer neighbours are within 1 m.
  std::optional<Neighbours> around(const Eigen::Vector3d& point) {
    const auto wanted = map_point(static_cast<float>(point.x()), static_cast<float>(point.y()),
                                  static_cast<float>(point.z()), 0.0F);
    const int found = tree_.nearestKSearch(wanted, kNeighbours, indices_, squared_m2_);
    if (found < kNeighbours || !(squared_m2_.back() < kReach_m2)) return std::nullopt;
    Neighbours near;
    for (int i = 0; i < kNeighbours; ++i) {
      const auto index = static_cast<std::size_t>(indices_[static_cast<std::size_t>(i)]);
      near.row(i) = position_of((*points_)[index]);
    }
    return near;
  }

 private:
  Cloud::Ptr points_;
  pcl::KdTreeFLANN<pcl::PointXYZI> tree_;
  pcl::Indices indices_;
  std::vector<float> squared_m2_;
};

// Two points on the line fitted to the neighbours; nothing if they are not in a line.
std::optional<std::array<Eigen::Vector3d, 2>> line_of(const Neighbours& near) {
  const Eigen::RowVector3d centre = near.colwise().mean();
  const Neighbours centred = near.rowwise() - centre;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(centred.transpose() * centred);
  if (!(solver.eigenvalues()[2] > kLineRatio * solver.eigenvalues()[1])) return std::nullopt;
  const Eigen::Vector3d half = kLineHalf_m * solver.eigenvectors().col(2);
  return std::array<Eigen::Vector3d, 2>{centre.transpose() + half, centre.transpose() - half};
}

struct Plane {
  Eigen::Vector3d normal;
  double offset;
};

// Solves n . p + 1 = 0 by least squares; for a plane through the origin there is no such n.
std::optional<Plane> plane_of(const Neighbours& near) {
  const Eigen::Matrix<double, kNeighbours, 1> minus_one =
      Eigen::Matrix<double, kNeighbours, 1>::Constant(-1.0);
  const Eigen::Vector3d normal = near.colPivHouseholderQr().solve(minus_one);
  const double length = normal.norm();
  const Plane plane{normal / length, 1.0 / length};
  for (int i = 0; i < kNeighbours; ++i) {
    const double off_m = near.row(i).dot(plane.normal) + plane.offset;
    if (!(std::abs(off_m) <= kPlane_m)) return std::nullopt;
  }
  return plane;
}

std::uint32_t add_lines(const Cloud& points, NearestPoints& layer, const Motion& motion,
                        MotionProblem& problem) {
  std::uint32_t count = 0;
  for (const pcl::PointXYZI& p : points) {
    const Eigen::Vector3d point = position_of(p);
    const auto near = layer.around(motion * point);
    const auto line = near ? line_of(*near) : std::nullopt;
    if (!line) continue;
    problem.add(LineCost::create(point, (*line)[0], (*line)[1], 1.0));
    ++count;
  }
  return count;
}

std::uint32_t add_planes(const Cloud& points, NearestPoints& layer, const Motion& motion,
                         MotionProblem& problem) {
  std::uint32_t count = 0;
  for (const pcl::PointXYZI& p : points) {
    const Eigen::Vector3d point = position_of(p);
    const auto near = layer.around(motion * point);
    const auto plane = near ? plane_of(*near) : std::nullopt;
    if (!plane) continue;
    problem.add(NormalCost::create(point, plane->normal, plane->offset));
    ++count;
  }
  return count;
}

Cloud::Ptr cloud_of(PointSpan points) {
  Cloud::Ptr cloud(new Cloud);
  cloud->reserve(points.size());
  for (const Point& p : points) {
    if (!p.position().allFinite()) continue;
    cloud->push_back(map_point(p.x, p.y, p.z, p.intensity));
  }
  return cloud;
}

Cloud in_map(const Cloud& points, const Pose& T_map_base) {
  Cloud out;
  out.reserve(points.size());
  for (const pcl::PointXYZI& p : points) out.push_back(moved(p, T_map_base));
  return out;
}

}  // namespace

ScanToMap::ScanToMap(const Leaves& leaves) : leaves_(leaves), map_(leaves.edge_m, leaves.plane_m) {}

void ScanToMap::match(const Cloud& edges, const Cloud& planes, Mapped& result) const {
  const LocalMap local = map_.local();
  if (local.edges->size() <= kFewestEdges || local.planes->size() <= kFewestPlanes) return;
  NearestPoints edge_layer(local.edges);
  NearestPoints plane_layer(local.planes);
  Motion motion = Motion::of(result.T_map_base);
  for (int round = 0; round < kRounds; ++round) {
    MotionProblem problem(motion);
    result.lines = add_lines(edges, edge_layer, motion, problem);
    result.planes = add_planes(planes, plane_layer, motion, problem);
    if (problem.correspondences() < kFewestCorrespondences) continue;
    const Solved solved = problem.solve();
    if (!solved.usable) continue;
    result.iterations += solved.iterations;
    result.residual_m = solved.residual_m;
    result.matched = true;
  }
  result.T_map_base = normalised(motion.pose());
}

Mapped ScanToMap::process(PointSpan edges, PointSpan planes, const Pose& T_odom_base) {
  Mapped result;
  result.T_map_base = normalised(T_map_odom_ * T_odom_base);
  map_.follow(result.T_map_base.translation());
  const Cloud::Ptr edge_points =
      voxel_filtered(cloud_of(edges), static_cast<float>(leaves_.edge_m));
  const Cloud::Ptr plane_points =
      voxel_filtered(cloud_of(planes), static_cast<float>(leaves_.plane_m));
  match(*edge_points, *plane_points, result);
  T_map_base_ = result.T_map_base;
  T_map_odom_ = normalised(result.T_map_base * T_odom_base.inverse());
  map_.insert(in_map(*edge_points, result.T_map_base), in_map(*plane_points, result.T_map_base));
  map_.filter_local();
  return result;
}

void ScanToMap::continue_from(const Pose& T_odom_base) {
  T_map_odom_ = normalised(T_map_base_ * T_odom_base.inverse());
}

void ScanToMap::restore(const Pose& T_map_base, const Pose& T_map_odom) {
  T_map_base_ = T_map_base;
  T_map_odom_ = T_map_odom;
}

}  // namespace zloam::aloam
