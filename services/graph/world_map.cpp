#include "graph/world_map.hpp"

#include "common/geometry/map_file.hpp"

namespace zloam::graph {

std::string write_world_map(const std::string& path, std::size_t count,
                            const std::function<std::optional<PlacedPoints>()>& next) {
  return write_map(path, count, [&] {
    std::vector<LayeredPoint> points;
    const std::optional<PlacedPoints> part = next();
    if (!part) return points;
    points.reserve(part->points.size());
    for (const MapPoint& p : part->points) {
      const Eigen::Vector3f world =
          (part->T_world_submap * Eigen::Vector3d(p.x, p.y, p.z)).cast<float>();
      // A submap does not tell which of its points were edges.
      points.push_back({{world.x(), world.y(), world.z(), p.intensity}, Layer::kPlane});
    }
    return points;
  });
}

}  // namespace zloam::graph
