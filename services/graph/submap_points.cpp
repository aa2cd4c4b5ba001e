#include "graph/submap_points.hpp"

#include <span>

namespace zloam::graph {

void SubmapPoints::add(const std::vector<MapPoint>& points) {
  if (folder_.empty()) return;
  const auto offset = file_.append(std::as_bytes(std::span(points)));
  if (!offset) return;
  places_.push_back({*offset, points.size()});
  count_ += points.size();
}

std::vector<MapPoint> SubmapPoints::of(std::size_t submap) const {
  const Place& place = places_.at(submap);
  std::vector<MapPoint> points(place.count);
  if (!file_.read(place.offset, std::as_writable_bytes(std::span(points)))) points.clear();
  return points;
}

}  // namespace zloam::graph
