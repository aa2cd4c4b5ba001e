#pragma once
// Points of the map as messages and files have them.

#include <vector>

#include "aloam/core/cube_map.hpp"
#include "common/geometry/map_layer.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::aloam {

inline const Cloud& layer_of(const Cube& cube, Layer layer) {
  return layer == Layer::kEdge ? *cube.edges : *cube.planes;
}

inline std::vector<MapPoint> map_points(const Cloud& cloud) {
  std::vector<MapPoint> points;
  points.reserve(cloud.size());
  for (const pcl::PointXYZI& p : cloud) points.push_back({p.x, p.y, p.z, p.intensity});
  return points;
}

inline Cloud::Ptr cloud_of(std::span<const MapPoint> points) {
  Cloud::Ptr cloud(new Cloud);
  cloud->reserve(points.size());
  for (const MapPoint& p : points) cloud->push_back(map_point(p.x, p.y, p.z, p.intensity));
  return cloud;
}

inline std::vector<MapPoint> in_map(PointSpan points, const Pose& T_map_base) {
  std::vector<MapPoint> out;
  out.reserve(points.size());
  for (const Point& p : points) {
    const Point q = moved(p, T_map_base);
    out.push_back({q.x, q.y, q.z, q.intensity});
  }
  return out;
}

/// Both layers of a cube, edges first.
inline std::vector<LayeredPoint> layered_points(const Cube& cube) {
  std::vector<LayeredPoint> points;
  for (const Layer layer : kLayers) {
    for (const MapPoint& p : map_points(layer_of(cube, layer))) points.push_back({p, layer});
  }
  return points;
}

}  // namespace zloam::aloam
