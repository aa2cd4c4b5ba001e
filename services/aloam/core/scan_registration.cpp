#include "aloam/core/scan_registration.hpp"

#include <pcl/filters/filter.h>
#include <pcl/filters/voxel_grid.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

#include "aloam/core/clouds.hpp"

namespace zloam::aloam {
namespace {

constexpr std::size_t kNeighbours = 5;
constexpr std::size_t kSegments = 6;
constexpr int kSharp = 2;
constexpr int kLessSharp = 20;
constexpr int kFlat = 4;
constexpr float kCurvature = 0.1F;
constexpr float kLargestStep_m2 = 0.05F;
constexpr float kLessFlatLeaf_m = 0.2F;

// Bounds of a ring's segments, [first, last), among the points that have a curvature.
std::array<std::size_t, kSegments + 1> segments_of(std::size_t points) {
  const std::size_t first = kNeighbours;
  const std::size_t whole = points - 2 * kNeighbours - 1;
  std::array<std::size_t, kSegments + 1> bounds{};
  for (std::size_t k = 0; k <= kSegments; ++k) bounds[k] = first + whole * k / kSegments;
  return bounds;
}

float squared_step(const TimedPoint& a, const TimedPoint& b) {
  return (a.getVector3fMap() - b.getVector3fMap()).squaredNorm();
}

// Picks the features of one ring.
class Ring {
 public:
  Ring(const TimedCloud& points, std::uint16_t ring, ScanFeatures& out)
      : points_(points),
        ring_(ring),
        out_(out),
        curvature_(points.size(), 0.0F),
        picked_(points.size(), false),
        less_sharp_(points.size(), false) {}

  void pick() {
    // A-LOAM skips a ring if the ends of its usable part are less than six points apart.
    if (points_.size() < 2 * kNeighbours + 1 + kSegments) return;
    for (std::size_t i = kNeighbours; i + kNeighbours < points_.size(); ++i) {
      curvature_[i] = curvature_at(i);
    }
    const auto bounds = segments_of(points_.size());
    TimedCloud::Ptr rest(new TimedCloud);
    for (std::size_t k = 0; k < kSegments; ++k) {
      sort(bounds[k], bounds[k + 1]);
      pick_edges();
      pick_flats();
      for (std::size_t i = bounds[k]; i < bounds[k + 1]; ++i) {
        if (!less_sharp_[i]) rest->push_back(points_[i]);
      }
    }
    filter(rest);
  }

 private:
  float curvature_at(std::size_t i) const {
    Eigen::Vector3f sum = -2.0F * static_cast<float>(kNeighbours) * points_[i].getVector3fMap();
    for (std::size_t n = 1; n <= kNeighbours; ++n) {
      sum += points_[i - n].getVector3fMap() + points_[i + n].getVector3fMap();
    }
    return sum.squaredNorm();
  }

  // Sorts by ascending curvature. Equal curvatures keep their order, so that equal sweeps give
  // equal bytes.
  void sort(std::size_t first, std::size_t last) {
    order_.clear();
    for (std::size_t i = first; i < last; ++i) order_.push_back(i);
    std::ranges::stable_sort(order_, {}, [this](std::size_t i) { return curvature_[i]; });
  }

  void pick_edges() {
    int count = 0;
    for (auto at = order_.rbegin(); at != order_.rend(); ++at) {
      if (picked_[*at] || !(curvature_[*at] > kCurvature)) continue;
      if (++count > kLessSharp) return;
      if (count <= kSharp) out_.sharp.push_back(point_of(points_[*at], ring_));
      out_.less_sharp.push_back(point_of(points_[*at], ring_));
      less_sharp_[*at] = true;
      suppress_around(*at);
    }
  }

  // As released, the last flat point of a segment suppresses nothing.
  void pick_flats() {
    int count = 0;
    for (const std::size_t i : order_) {
      if (picked_[i] || !(curvature_[i] < kCurvature)) continue;
      out_.flat.push_back(point_of(points_[i], ring_));
      if (++count >= kFlat) return;
      suppress_around(i);
    }
  }

  // Every point with a curvature has five neighbours on either side.
  void suppress_around(std::size_t i) {
    picked_[i] = true;
    for (std::size_t n = 1; n <= kNeighbours; ++n) {
      if (squared_step(points_[i + n], points_[i + n - 1]) > kLargestStep_m2) break;
      picked_[i + n] = true;
    }
    for (std::size_t n = 1; n <= kNeighbours; ++n) {
      if (squared_step(points_[i - n], points_[i - n + 1]) > kLargestStep_m2) break;
      picked_[i - n] = true;
    }
  }

  void filter(const TimedCloud::Ptr& rest) {
    TimedCloud filtered;
    pcl::VoxelGrid<TimedPoint> grid;
    grid.setInputCloud(rest);
    grid.setLeafSize(kLessFlatLeaf_m, kLessFlatLeaf_m, kLessFlatLeaf_m);
    grid.filter(filtered);
    for (const TimedPoint& p : filtered) out_.less_flat.push_back(point_of(p, ring_));
  }

  const TimedCloud& points_;
  std::uint16_t ring_;
  ScanFeatures& out_;
  std::vector<float> curvature_;
  std::vector<bool> picked_;
  std::vector<bool> less_sharp_;
  std::vector<std::size_t> order_;
};

bool is_strongest(const Point& p) {
  return p.return_type == ReturnType::kStrongest || p.return_type == ReturnType::kBoth;
}

double elevation_deg(const Eigen::Vector3d& p) {
  return std::atan2(p.z(), std::hypot(p.x(), p.y())) * 180.0 / std::numbers::pi;
}

bool is_within(const Eigen::Vector3d& p, double min_range_m, const Elevations& elevations) {
  const double elevation = elevation_deg(p);
  return p.squaredNorm() >= min_range_m * min_range_m && elevation >= elevations.least_deg &&
         elevation <= elevations.greatest_deg;
}

}  // namespace

ScanFeatures extract_features(PointSpan sweep, double min_range_m, const Elevations& elevations,
                              std::uint32_t rings, bool one_return) {
  std::map<std::uint16_t, TimedCloud> by_ring;
  for (const Point& p : sweep) {
    if (!(one_return || is_strongest(p)) || p.ring >= rings) continue;
    if (!is_within(p.position().cast<double>(), min_range_m, elevations)) continue;
    TimedCloud& ring = by_ring[p.ring];
    ring.push_back(timed_point(p));
    // PCL removes points that are not finite only from clouds that are not marked as dense.
    ring.is_dense = false;
  }
  ScanFeatures out;
  std::size_t used = 0;
  pcl::Indices kept;
  for (auto& [number, points] : by_ring) {
    pcl::removeNaNFromPointCloud(points, points, kept);
    used += points.size();
    Ring(points, number, out).pick();
  }
  out.rejected = static_cast<std::uint32_t>(sweep.size() - used);
  return out;
}

std::string rings_error(std::uint32_t rings, std::uint32_t slices) {
  if (rings > 0) return {};
  const std::string what =
      "the sweeps have no rings (their field rings is 0), and A-LOAM takes its features from "
      "rings, so there are none: ";
  if (slices > 1) return what + "leave out --method";
  return what + "leave registration to the default method (--method odometry=aloam,mapping=aloam)";
}

std::string slices_error(std::uint32_t slices) {
  if (slices <= 1) return {};
  return "a sweep shows only a part of the view (its field slices is " + std::to_string(slices) +
         "), and A-LOAM matches it with the sweep before, which shows another: leave out --method";
}

}  // namespace zloam::aloam
