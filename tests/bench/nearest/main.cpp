// What five nearest neighbours cost per sweep: a kd-tree over the local map, rebuilt for each sweep
// as A-LOAM does (PCL, FLANN), against the map's own cell hash, which is always current. One JSON
// line.

#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <array>
#include <ctime>
#include <iostream>
#include <random>

#include "mapping/layer_map.hpp"

namespace {

using zloam::mapping::LayerMap;
using zloam::mapping::Neighbour;

constexpr int kSweeps = 20;
constexpr int kPointsPerSweep = 5000;
constexpr int kMapPoints = 60000;

double cpu_ms() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}

Eigen::Vector3d surface_point(std::mt19937& rng) {
  std::uniform_real_distribution<double> along(-100.0, 100.0);
  std::normal_distribution<double> noise(0.0, 0.02);
  const double u = along(rng);
  const double v = along(rng);
  return rng() % 2 == 0 ? Eigen::Vector3d(u, v, noise(rng))
                        : Eigen::Vector3d(u, 10.0 + noise(rng), v / 12.0 + 8.0);
}

double kd_tree_ms(const pcl::PointCloud<pcl::PointXYZ>::Ptr& map,
                  const std::vector<Eigen::Vector3d>& queries) {
  const double begin = cpu_ms();
  double sum = 0.0;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    pcl::KdTreeFLANN<pcl::PointXYZ> tree;
    tree.setInputCloud(map);
    pcl::Indices indices;
    std::vector<float> squared;
    for (const Eigen::Vector3d& q : queries) {
      tree.nearestKSearch(
          {static_cast<float>(q.x()), static_cast<float>(q.y()), static_cast<float>(q.z())}, 5,
          indices, squared);
      sum += squared.back();
    }
  }
  return sum >= 0.0 ? (cpu_ms() - begin) / kSweeps : 0.0;
}

double cell_hash_ms(LayerMap& layer, const std::vector<Eigen::Vector3d>& queries) {
  const double begin = cpu_ms();
  double sum = 0.0;
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (const Eigen::Vector3d& q : queries) {
      layer.insert(q, 1.0F);
    }
    std::array<Neighbour, 5> found;
    for (const Eigen::Vector3d& q : queries) {
      layer.nearest(q, 1.0, found);
      sum += found[0].squared_m2;
    }
  }
  return sum >= 0.0 ? (cpu_ms() - begin) / kSweeps : 0.0;
}

}  // namespace

int main() {
  std::mt19937 rng(1);
  LayerMap layer(0.4, 50.0, 1.0);
  auto cloud = pcl::make_shared<pcl::PointCloud<pcl::PointXYZ>>();
  for (int i = 0; i < kMapPoints; ++i) {
    layer.insert(surface_point(rng), 1.0F);
  }
  for (const auto& tile : layer.tiles()) {
    for (const auto& p : layer.tile_points(tile)) {
      const Eigen::Vector3f m = p.mean.cast<float>();
      cloud->push_back({m.x(), m.y(), m.z()});
    }
  }
  std::vector<Eigen::Vector3d> queries;
  queries.reserve(kPointsPerSweep);
  for (int i = 0; i < kPointsPerSweep; ++i) {
    queries.push_back(surface_point(rng));
  }
  const double theirs = kd_tree_ms(cloud, queries);
  const double ours = cell_hash_ms(layer, queries);
  std::cout << "{\"map_points\": " << cloud->size() << ", \"queries\": " << kPointsPerSweep
            << ", \"kd_tree_ms\": " << theirs << ", \"cell_hash_ms\": " << ours
            << ", \"ratio\": " << theirs / ours << "}\n";
  return 0;
}
