// Static and moving points, from rays into a simulated street whose truth is known.

#include "sessions/standing.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>

#include "mapping/submap_builder.hpp"

namespace zloam::sessions {
namespace {

struct Box {
  Eigen::Vector3d low, high;
};

/// Distance at which the ray enters the box; nothing if it misses.
std::optional<double> entered(const Box& box, const Eigen::Vector3d& from,
                              const Eigen::Vector3d& along) {
  double near = 0.05, far = 60.0;
  for (int axis = 0; axis < 3; ++axis) {
    double a = (box.low[axis] - from[axis]) / along[axis];
    double b = (box.high[axis] - from[axis]) / along[axis];
    if (a > b) std::swap(a, b);
    near = std::max(near, a);
    far = std::min(far, b);
  }
  if (!(near < far) || near <= 0.05) return std::nullopt;
  return near;
}

/// A street: ground, walls, posts and a parked car are static; a car and a person move.
struct Street {
  std::vector<Box> standing = {{{-80, -80, -1}, {80, 80, 0}},  {{-80, 12, 0}, {80, 13, 8}},
                               {{-80, -13, 0}, {80, -12, 8}},  {{6, 5, 0}, {10.5, 6.8, 1.5}},
                               {{14, -6, 0}, {14.2, -5.8, 5}}, {{2, 6.5, 0}, {2.2, 6.7, 5}},
                               {{-6, -7, 0}, {-5.8, -6.8, 5}}};
  double car_mps = -9.0, person_mps = 1.3;

  std::vector<Box> moving_at(double time_s) const {
    const double car = 25.0 + car_mps * time_s, person = -3.0 + person_mps * time_s;
    return {{{car, 2.0, 0.1}, {car + 4.2, 3.8, 1.5}},
            {{9.0, person, 0.0}, {9.5, person + 0.5, 1.75}}};
  }
};

struct Seen {
  Submap submap;
  /// for each of its points
  std::vector<bool> moved;
};

double distance_m(const Box& box, const Eigen::Vector3d& p) {
  const Eigen::Vector3d inside = p.cwiseMax(box.low).cwiseMin(box.high);
  return (p - inside).norm();
}

/// Seen from a platform at 5 m/s, with 16 rings and 10 revolutions per second.
Seen driven(const Street& street, unsigned seed, double speed_mps = 5.0) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0.0, 0.02);
  mapping::SubmapBuilder builder(10.0);
  std::optional<Submap> closed;
  for (std::uint64_t sweep = 0; !closed; ++sweep) {
    const double time_s = 0.1 * static_cast<double>(sweep);
    Pose T_map_base = Pose::Identity();
    T_map_base.translation().x() = speed_mps * time_s;
    const Eigen::Vector3d sensor = T_map_base * Eigen::Vector3d(0.0, 0.0, 1.8);
    std::vector<Box> all = street.standing;
    for (const Box& box : street.moving_at(time_s)) all.push_back(box);
    PointVector points;
    for (int ring = 0; ring < 16; ++ring) {
      for (int step = 0; step < 900; ++step) {
        const double up = (-15.0 + 2.0 * ring) * std::numbers::pi / 180.0;
        const double around = 2.0 * std::numbers::pi * (step + 0.37 * ring) / 900.0 + 1e-3;
        const Eigen::Vector3d along(std::cos(up) * std::cos(around),
                                    std::cos(up) * std::sin(around), std::sin(up));
        double range = std::numeric_limits<double>::infinity();
        for (const Box& box : all)
          range = std::min(range, entered(box, sensor, along).value_or(range));
        if (!std::isfinite(range)) continue;
        const Eigen::Vector3d p = T_map_base.inverse() * (sensor + (range + noise(random)) * along);
        points.push_back({static_cast<float>(p.x()),
                          static_cast<float>(p.y()),
                          static_cast<float>(p.z()),
                          1.0F,
                          0,
                          0,
                          {},
                          0});
      }
    }
    mapping::SubmapInput input;
    input.sweep = sweep;
    input.instant_ns = static_cast<std::int64_t>(time_s * 1e9) + 1;
    input.T_map_base = T_map_base;
    input.found = true;
    input.origin_base = {0.0, 0.0, 1.8};
    input.planes = points;
    closed = builder.add(input);
  }
  Seen out{std::move(*closed), {}};
  for (const MapPoint& p : out.submap.points) {
    const Eigen::Vector3d at = out.submap.T_map_submap * Eigen::Vector3d(p.x, p.y, p.z);
    double nearest = std::numeric_limits<double>::infinity();
    for (const Box& box : street.standing) nearest = std::min(nearest, distance_m(box, at));
    out.moved.push_back(nearest > 0.2);
  }
  return out;
}

struct Shares {
  double moving_found = 0.0, standing_kept = 0.0;
  std::size_t moving = 0;
};

Shares judged(const Seen& seen) {
  const std::vector<bool> found = moving_points(seen.submap);
  std::size_t out = 0, kept = 0, standing = 0;
  Shares shares;
  for (std::size_t i = 0; i < found.size(); ++i) {
    (seen.moved[i] ? shares.moving : standing) += 1;
    out += seen.moved[i] && found[i] ? 1U : 0U;
    kept += !seen.moved[i] && !found[i] ? 1U : 0U;
  }
  shares.moving_found =
      static_cast<double>(out) / static_cast<double>(std::max<std::size_t>(1, shares.moving));
  shares.standing_kept = static_cast<double>(kept) / static_cast<double>(standing);
  return shares;
}

TEST(Standing, WhatMovesGoesAndWhatStandsStays) {
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const Shares shares = judged(driven(Street{}, seed));
    ASSERT_GT(shares.moving, 200U);
    EXPECT_GT(shares.moving_found, 0.9) << seed;
    EXPECT_GT(shares.standing_kept, 0.99) << seed;
  }
}

TEST(Standing, AStreetInWhichNothingMovesStaysAsItIs) {
  Street still;
  still.car_mps = still.person_mps = 0.0;
  Seen seen = driven(still, 1);
  const std::vector<bool> found = moving_points(seen.submap);
  EXPECT_LT(std::count(found.begin(), found.end(), true), 0.01 * static_cast<double>(found.size()));
}

TEST(Standing, WithoutWhatTheSweepsHitNothingIsTakenOut) {
  Seen seen = driven(Street{}, 1);
  ASSERT_LT(standing(seen.submap).points.size(), seen.submap.points.size());
  seen.submap.hits.clear();
  EXPECT_EQ(standing(seen.submap).points.size(), seen.submap.points.size());
}

}  // namespace
}  // namespace zloam::sessions
