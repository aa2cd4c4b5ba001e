// Which points of a sweep are selected, and in which order.
#include "common/plane_map/sweep_points.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>

namespace zloam::plane_map {
namespace {

constexpr std::uint32_t kPeriod_ns = 100'000'000;

/// A sweep ring by ring, as odometry publishes it; x is the number of the firing plus one.
PointVector full_sweep(int rings, int firings) {
  PointVector points;
  for (int ring = 0; ring < rings; ++ring) {
    for (int f = 0; f < firings; ++f) {
      Point p{};
      p.x = static_cast<float>(1 + f);
      p.ring = static_cast<std::uint16_t>(ring);
      p.time_ns = static_cast<std::uint32_t>(std::uint64_t{kPeriod_ns} * static_cast<unsigned>(f) /
                                             static_cast<unsigned>(firings));
      points.push_back(p);
    }
  }
  return points;
}

SweepInput input_of(PointSpan points, PointSpan more_points = {}) {
  SweepInput input;
  input.points = points;
  input.more_points = more_points;
  input.period_ns = kPeriod_ns;
  return input;
}

TEST(SweepPoints, OfAThinnedSweepEveryRingHasItsShare) {
  constexpr int kRings = 16;
  constexpr int kFirings = 1800;
  const PointVector sweep = full_sweep(kRings, kFirings);
  for (const std::size_t stride : {2U, 3U, 4U, 12U}) {
    for (std::size_t first = 0; first < stride; ++first) {
      SweepPoints points;
      points.set(input_of(sweep), 0.5, {stride, first});
      std::map<std::uint16_t, std::size_t> of_ring;
      for (const SlotPoint& p : points.points()) ++of_ring[p.ring];
      ASSERT_EQ(of_ring.size(), kRings) << stride;
      for (const auto& [ring, count] : of_ring) EXPECT_NEAR(count, kFirings / stride, 1) << ring;
    }
  }
}

TEST(SweepPoints, AllPointsHaveTheirTurn) {
  const PointVector edges = full_sweep(1, 101);
  const PointVector planes = full_sweep(3, 100);
  constexpr std::size_t kStride = 7;
  std::map<std::pair<std::uint16_t, float>, int> taken;
  for (std::size_t sweep = 100; sweep < 100 + kStride; ++sweep) {
    SweepPoints points;
    points.set(input_of(edges, planes), 0.5, {kStride, sweep});
    for (const SlotPoint& p : points.points()) ++taken[{p.ring, p.x}];
  }
  for (const auto& [point, times] : taken) {
    // Ring 0 is in both parts.
    EXPECT_EQ(times, point.first == 0 && point.second <= 100.0F ? 2 : 1);
  }
  EXPECT_EQ(taken.size(), 301U);
}

// Stretches consist of successive firings, also across the end of the first part.
TEST(SweepPoints, NeighboursAreTakenTogether) {
  const PointVector edges = full_sweep(1, 101);
  PointVector planes = full_sweep(1, 150);
  for (Point& p : planes) p.x += 101.0F;
  constexpr std::size_t kStride = 3, kTogether = 4;
  std::vector<SlotPoint> points;
  for (std::size_t first = 0; first < 2 * kStride; ++first) {
    take_points(input_of(edges, planes), 0.5, {kStride, first, kTogether}, points);
    std::vector<int> taken;
    for (const SlotPoint& p : points) taken.push_back(static_cast<int>(p.x) - 1);
    std::sort(taken.begin(), taken.end());
    std::vector<int> expected;
    for (std::size_t i = 0; i < edges.size() + planes.size(); ++i) {
      if (i / kTogether % kStride == first % kStride) expected.push_back(static_cast<int>(i));
    }
    EXPECT_EQ(taken, expected) << first;
  }
}

TEST(SweepPoints, AreInOrderOfTheirTimes) {
  SweepPoints points;
  points.set(input_of(full_sweep(16, 1800)), 0.5, {5, 3});
  // Of each ring a fifth, up to one point.
  ASSERT_NEAR(points.points().size(), 16 * 1800 / 5, 16);
  for (std::size_t i = 1; i < points.points().size(); ++i) {
    EXPECT_LE(points.points()[i - 1].slot, points.points()[i].slot);
  }
}

}  // namespace
}  // namespace zloam::plane_map
