// The map's nearest-neighbour search against an independent one: PCL's kd-tree (FLANN) over the
// same points.

#include <gtest/gtest.h>
#include <pcl/kdtree/kdtree_flann.h>
#include <pcl/point_cloud.h>
#include <pcl/point_types.h>

#include <array>
#include <random>

#include "mapping/layer_map.hpp"

namespace zloam::mapping {
namespace {

LayerMap street(std::mt19937& rng) {
  LayerMap layer(0.4, 50.0, 1.0);
  std::uniform_real_distribution<double> along(-60.0, 60.0);
  std::uniform_real_distribution<double> height(0.0, 8.0);
  std::normal_distribution<double> noise(0.0, 0.02);
  for (int i = 0; i < 20000; ++i) {
    layer.insert({along(rng), 10.0 + noise(rng), height(rng)}, 1.0F);
    layer.insert({along(rng), along(rng) / 6.0, noise(rng)}, 1.0F);
  }
  return layer;
}

pcl::PointCloud<pcl::PointXYZ>::Ptr means_of(const LayerMap& layer) {
  auto cloud = pcl::make_shared<pcl::PointCloud<pcl::PointXYZ>>();
  for (const TileIndex& tile : layer.tiles()) {
    for (const CountedPoint& p : layer.tile_points(tile)) {
      const Eigen::Vector3f m = p.mean.cast<float>();
      cloud->push_back({m.x(), m.y(), m.z()});
    }
  }
  return cloud;
}

TEST(NearestNeighbours, AreThoseOfAKdTreeOverTheSamePoints) {
  std::mt19937 rng(5);
  const LayerMap layer = street(rng);
  const auto cloud = means_of(layer);
  ASSERT_EQ(cloud->size(), layer.point_count());
  pcl::KdTreeFLANN<pcl::PointXYZ> tree;
  tree.setInputCloud(cloud);

  std::uniform_real_distribution<double> x(-62.0, 62.0);
  std::uniform_real_distribution<double> y(-12.0, 12.0);
  std::uniform_real_distribution<double> z(-1.0, 9.0);
  std::size_t found_five = 0;
  for (int i = 0; i < 3000; ++i) {
    const Eigen::Vector3d query(x(rng), y(rng), z(rng));
    std::array<Neighbour, 5> ours;
    const std::size_t n = layer.nearest(query, 1.0, ours);
    pcl::Indices indices;
    std::vector<float> squared;
    const Eigen::Vector3f q = query.cast<float>();
    tree.nearestKSearch({q.x(), q.y(), q.z()}, 5, indices, squared);
    // Single precision on their side: a neighbour at the very radius may fall on either side.
    std::size_t within = 0;
    while (within < squared.size() && squared[within] < 1.0F - 1e-5F) ++within;
    ASSERT_GE(n, within);
    for (std::size_t k = 0; k < within; ++k) {
      EXPECT_NEAR(ours[k].squared_m2, squared[k], 2e-5);
    }
    found_five += within == 5 ? 1 : 0;
  }
  EXPECT_GT(found_five, 300U);
}

}  // namespace
}  // namespace zloam::mapping
