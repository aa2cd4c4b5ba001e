#include "sessions/standing.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <unordered_map>

#include "common/geometry/floor.hpp"
#include "common/geometry/grid_key.hpp"

namespace zloam::sessions {
namespace {

// Bins of directions: their size, columns around, rows from -45 to 45 degrees of elevation.
constexpr float kBin_rad = std::numbers::pi_v<float> / 180.0F;
constexpr int kColumns = 360, kRows = 90;
// A ray passes through a place if it comes this near to it, which is less than the thickness of
// static objects.
constexpr float kClose_m = 0.1F;
// If a ray that passes this near hits something at the same range within this, both are one object,
// and the place is at its edge.
constexpr float kEdge_m = 0.4F;
// Least distance from the place to what the ray hits behind it, in m or as a share of the range:
// along a flat surface a ray stays close for a long way.
constexpr float kBehind_m = 1.0F, kBehindShare = 0.2F;
// A moving point is seen through at least this often, and more often than it is hit.
constexpr int kFewest = 2;
// Neighbours within this reach belong to one object. A point moved with it if at least this many
// neighbours moved, and more than one in three of them; repeated for this many passes.
constexpr double kReach_m = 0.45;
constexpr int kBeside = 3, kOneIn = 3, kPasses = 4;
// A point this much above the lowest points around it is not ground.
constexpr float kGround_m = 0.25F;

/// Rays of one group of sweeps by direction, from the sensor's position in the middle of the group.
class View {
 public:
  View(const Submap& submap, std::size_t group)
      : origin_(submap.origins[group].cast<float>()), bins_(kColumns * kRows) {
    const std::uint64_t bit = std::uint64_t{1} << group;
    for (std::size_t i = 0; i < submap.points.size(); ++i) {
      if ((submap.hits[i] & bit) == 0) continue;
      const Ray ray = ray_to(submap.points[i]);
      const Direction at = direction_of(ray);
      if (at.row >= 0 && at.row < kRows) bins_[bin_of(at.row, at.column)].push_back(ray);
    }
  }

  bool sees_through(const MapPoint& point) const {
    const Ray to = ray_to(point);
    const float behind_m = to.range_m + std::max(kBehind_m, kBehindShare * to.range_m);
    const float close = cosine_of(kClose_m, to.range_m), beside = cosine_of(kEdge_m, to.range_m);
    bool through = false;
    const Direction at = direction_of(to);
    for (int row = std::max(0, at.row - 1); row <= std::min(kRows - 1, at.row + 1); ++row) {
      for (int column = at.column - 1; column <= at.column + 1; ++column) {
        for (const Ray& ray : bins_[bin_of(row, column)]) {
          const float cosine = ray.direction.dot(to.direction);
          if (cosine < beside) continue;
          if (std::abs(ray.range_m - to.range_m) < kEdge_m) return false;
          through = through || (ray.range_m > behind_m && cosine > close);
        }
      }
    }
    return through;
  }

 private:
  /// Cosine of the angle at which a width is seen, for small angles.
  static float cosine_of(float width_m, float range_m) {
    const float angle = width_m / std::max(range_m, width_m);
    return 1.0F - 0.5F * angle * angle;
  }
  struct Ray {
    Eigen::Vector3f direction;
    float range_m;
  };

  Ray ray_to(const MapPoint& p) const {
    const Eigen::Vector3f way = Eigen::Vector3f(p.x, p.y, p.z) - origin_;
    const float range_m = way.norm();
    return {way / std::max(range_m, 1e-3F), range_m};
  }

  struct Direction {
    int row, column;
  };
  static Direction direction_of(const Ray& ray) {
    const float up = std::asin(std::clamp(ray.direction.z(), -1.0F, 1.0F));
    const float around = std::atan2(ray.direction.y(), ray.direction.x());
    return {kRows / 2 + static_cast<int>(std::floor(up / kBin_rad)),
            kColumns / 2 + static_cast<int>(std::floor(around / kBin_rad))};
  }
  static std::size_t bin_of(int row, int column) {
    return static_cast<std::size_t>(row * kColumns + (column + kColumns) % kColumns);
  }

  Eigen::Vector3f origin_;
  std::vector<std::vector<Ray>> bins_;
};

std::vector<int> times_seen_through(const Submap& submap) {
  std::vector<int> through(submap.points.size(), 0);
  for (std::size_t group = 0; group < submap.origins.size(); ++group) {
    const View view(submap, group);
    const std::uint64_t bit = std::uint64_t{1} << group;
    for (std::size_t i = 0; i < submap.points.size(); ++i) {
      const bool hit = (submap.hits[i] & bit) != 0;
      if (!hit && view.sees_through(submap.points[i])) ++through[i];
    }
  }
  return through;
}

/// Points by grid cell.
class Neighbourhood {
 public:
  explicit Neighbourhood(const std::vector<MapPoint>& points) {
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Cell c = cell_of(points[i]);
      cells_[key_of(c)].push_back(i);
    }
  }
  template <class Take>
  void around(const MapPoint& point, Take take) const {
    const Cell c = cell_of(point);
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        for (int dz = -1; dz <= 1; ++dz) {
          const auto found = cells_.find(key_of({c[0] + dx, c[1] + dy, c[2] + dz}));
          if (found == cells_.end()) continue;
          for (const std::size_t i : found->second) take(i);
        }
      }
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;
  static Cell cell_of(const MapPoint& p) {
    const auto cell = [](float v) {
      return floor_to<std::int64_t>(static_cast<double>(v) / kReach_m);
    };
    return {cell(p.x), cell(p.y), cell(p.z)};
  }
  static std::uint64_t key_of(const Cell& c) { return grid_key(c[0], c[1], c[2]); }
  std::unordered_map<std::uint64_t, std::vector<std::size_t>> cells_;
};

/// For each point, whether it is among the lowest points around it.
std::vector<bool> ground_points(const std::vector<MapPoint>& points) {
  std::unordered_map<std::uint64_t, float> lowest;
  const auto key = [](const MapPoint& p, int dx, int dy) {
    const auto cell = [](float v) { return floor_to<std::int64_t>(static_cast<double>(v)); };
    return grid_key(cell(p.x) + dx, cell(p.y) + dy, 0);
  };
  for (const MapPoint& p : points) {
    const auto [found, is_new] = lowest.try_emplace(key(p, 0, 0), p.z);
    if (!is_new) found->second = std::min(found->second, p.z);
  }
  std::vector<bool> ground;
  for (const MapPoint& p : points) {
    float least = p.z;
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dy = -1; dy <= 1; ++dy) {
        const auto found = lowest.find(key(p, dx, dy));
        if (found != lowest.end()) least = std::min(least, found->second);
      }
    }
    ground.push_back(p.z < least + kGround_m);
  }
  return ground;
}

/// Adds the rest of moving objects: points beside many moving points that were hit at no other
/// time, though nothing was seen behind them. Ground and walls are hit at other times, too.
void add_neighbours(const Submap& submap, const Neighbourhood& neighbourhood,
                    const std::vector<bool>& ground, std::vector<bool>& moving) {
  const std::vector<bool> seen = moving;
  for (std::size_t i = 0; i < moving.size(); ++i) {
    if (seen[i] || ground[i]) continue;
    int beside = 0, others = 0;
    std::uint64_t then = 0;
    neighbourhood.around(submap.points[i], [&](std::size_t other) {
      if (!seen[other]) {
        ++others;
        return;
      }
      ++beside;
      const std::uint64_t hits = submap.hits[other];
      then |= hits | hits << 1 | hits >> 1;
    });
    moving[i] =
        beside >= kBeside && kOneIn * beside > beside + others && (submap.hits[i] & ~then) == 0;
  }
}

}  // namespace

std::vector<bool> moving_points(const Submap& submap) {
  std::vector<bool> moving(submap.points.size(), false);
  if (submap.hits.size() != submap.points.size()) return moving;
  const std::vector<int> through = times_seen_through(submap);
  for (std::size_t i = 0; i < moving.size(); ++i) {
    moving[i] = through[i] >= kFewest && through[i] > std::popcount(submap.hits[i]);
  }
  const Neighbourhood neighbourhood(submap.points);
  const std::vector<bool> ground = ground_points(submap.points);
  for (int i = 0; i < kPasses; ++i) add_neighbours(submap, neighbourhood, ground, moving);
  return moving;
}

Submap standing(const Submap& submap) { return without(submap, moving_points(submap)); }

Submap without(const Submap& submap, const std::vector<bool>& moving) {
  Submap out = submap;
  out.points.clear();
  out.hits.clear();
  for (std::size_t i = 0; i < moving.size(); ++i) {
    if (moving[i]) continue;
    out.points.push_back(submap.points[i]);
    if (!submap.hits.empty()) out.hits.push_back(submap.hits[i]);
  }
  return out;
}

}  // namespace zloam::sessions
