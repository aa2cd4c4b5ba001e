#include "mapping/submap_builder.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace zloam::mapping {
namespace {

constexpr double kSigma_m = 0.01;

struct Drive {
  std::vector<PointVector> points;
  std::vector<SubmapInput> inputs;
};

Point point(double x, double y, double z) {
  return {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z), 5.0F, 0, 0, {}, 0};
}

/// A drive along x, step_m per sweep, past walls at y = +-8 m.
Drive drive(std::size_t sweeps, double step_m = 1.0) {
  Drive out;
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> along(-15.0, 15.0), up(0.0, 4.0);
  for (std::size_t i = 0; i < sweeps; ++i) {
    const double x = step_m * static_cast<double>(i);
    PointVector points;
    for (int k = 0; k < 200; ++k) {
      points.push_back(point(along(random), k % 2 == 0 ? 8.0 : -8.0, up(random)));
    }
    out.points.push_back(std::move(points));
    SubmapInput input;
    input.sweep = i;
    input.instant_ns = static_cast<std::int64_t>(i) * 100'000'000 + 1;
    input.T_map_base.translation().x() = x;
    input.covariance = Matrix6::Identity() * kSigma_m * kSigma_m;
    input.found = true;
    input.range_noise_m = 0.02;
    out.inputs.push_back(input);
  }
  for (std::size_t i = 0; i < sweeps; ++i) out.inputs[i].planes = out.points[i];
  return out;
}

std::vector<Submap> built(const Drive& drive, SubmapBuilder& builder) {
  std::vector<Submap> out;
  for (const SubmapInput& input : drive.inputs) {
    if (auto submap = builder.add(input)) out.push_back(std::move(*submap));
  }
  return out;
}

TEST(SubmapBuilder, CutsByWayAndPutsTheFrameIntoTheMiddle) {
  SubmapBuilder builder(10.0);
  const std::vector<Submap> submaps = built(drive(40), builder);
  ASSERT_EQ(submaps.size(), 3U);
  EXPECT_EQ(submaps[0].first_sweep, 0U);
  EXPECT_EQ(submaps[0].last_sweep, 10U);
  EXPECT_EQ(submaps[0].sweep, 5U);
  EXPECT_EQ(submaps[1].first_sweep, 11U);
  EXPECT_EQ(submaps[1].before_sweep, submaps[0].sweep);
  EXPECT_DOUBLE_EQ(submaps[1].step_m, 11.0);
  EXPECT_DOUBLE_EQ(submaps[1].T_map_submap.translation().x(), 16.0);
  EXPECT_TRUE(submaps[1].connected);
  ASSERT_FALSE(submaps[1].points.empty());
  for (const MapPoint& p : submaps[1].points) {
    EXPECT_NEAR(std::abs(p.y), 8.0, 1e-4);
    EXPECT_LT(std::abs(p.x), 15.0 + 5.1);
  }
  // Fewer than were given, because they are means of voxels.
  EXPECT_LT(submaps[1].points.size(), 11U * 200U);
}

TEST(SubmapBuilder, StandingStillNeitherEndsOneNorMakesItLessCertain) {
  SubmapBuilder moving(10.0), resting(10.0);
  const Drive once = drive(25);
  Drive rested = once;
  const SubmapInput still = rested.inputs[14];
  rested.inputs.insert(rested.inputs.begin() + 14, 500, still);
  const auto without = built(once, moving), with = built(rested, resting);
  ASSERT_EQ(without.size(), with.size());
  EXPECT_EQ(without[1].T_map_submap.matrix(), with[1].T_map_submap.matrix());
  EXPECT_EQ(without[1].step_covariance, with[1].step_covariance);
}

TEST(SubmapBuilder, BothEndsAreAsUncertainAsTheirMatches) {
  SubmapBuilder builder(10.0);
  const auto submaps = built(drive(40), builder);
  EXPECT_NEAR(std::sqrt(submaps[1].step_covariance(0, 0)), std::sqrt(2.0) * kSigma_m, 1e-6);
}

TEST(SubmapBuilder, WhatThePointsLeaveOpenAddsUp) {
  SubmapBuilder builder(10.0);
  Drive open = drive(40);
  for (SubmapInput& input : open.inputs) {
    input.degenerate = true;
    input.covariance(0, 0) = 0.04;
  }
  const auto submaps = built(open, builder);
  // Eleven sweeps of 0.2 m each, and both ends.
  EXPECT_NEAR(std::sqrt(submaps[1].step_covariance(0, 0)), 0.2 * std::sqrt(13.0), 0.01);
}

TEST(SubmapBuilder, ASweepThatWasNotFoundEndsOneAndIsInNone) {
  SubmapBuilder builder(10.0);
  Drive lost = drive(40);
  for (std::size_t i = 16; i < 20; ++i) {
    lost.inputs[i].found = false;
    lost.inputs[i].planes = {};
    lost.inputs[i].covariance = Matrix6::Identity() * 4.0;
  }
  const auto submaps = built(lost, builder);
  ASSERT_EQ(submaps.size(), 3U);
  EXPECT_EQ(submaps[1].first_sweep, 11U);
  EXPECT_EQ(submaps[1].last_sweep, 15U);
  EXPECT_EQ(submaps[2].first_sweep, 20U);
  EXPECT_FALSE(submaps[2].connected);
  // The covariance of the last unmatched pose counts once.
  EXPECT_NEAR(std::sqrt(submaps[2].step_covariance(0, 0)), 2.0, 0.01);
}

TEST(SubmapBuilder, APointWithoutIntensityLeavesItsVoxelOne) {
  SubmapBuilder builder(10.0);
  Drive some = drive(12);
  for (PointVector& points : some.points) {
    for (std::size_t k = 0; k < points.size(); k += 3) points[k].intensity = std::nanf("");
  }
  const auto submaps = built(some, builder);
  ASSERT_EQ(submaps.size(), 1U);
  for (const MapPoint& p : submaps[0].points) EXPECT_TRUE(std::isfinite(p.intensity));
}

TEST(SubmapBuilder, TheRestComesAtTheEnd) {
  SubmapBuilder builder(10.0);
  built(drive(16), builder);
  const auto rest = builder.finish();
  ASSERT_TRUE(rest.has_value());
  EXPECT_EQ(rest->first_sweep, 11U);
  EXPECT_EQ(rest->last_sweep, 15U);
  EXPECT_FALSE(builder.finish().has_value());
}

// The driver was restarted, and the map goes on: no sweep of a submap may have a higher number than
// the one that ends it.
TEST(SubmapBuilder, OneThatIsOpenWhenAnotherRunBeginsHasNumbersOfThatRun) {
  for (const bool found : {true, false}) {
    SubmapBuilder builder(10.0);
    Drive both = drive(40);
    std::vector<Submap> submaps;
    for (std::size_t i = 0; i < both.inputs.size(); ++i) {
      SubmapInput& input = both.inputs[i];
      input.sweep = i < 16 ? 100 + i : i - 16;
      input.found = found || i != 16;
      if (i == 16) builder.new_run();
      if (auto submap = builder.add(input)) {
        EXPECT_LE(submap->first_sweep, submap->sweep);
        EXPECT_LE(submap->sweep, submap->last_sweep);
        EXPECT_LE(submap->last_sweep, input.sweep);
        submaps.push_back(std::move(*submap));
      }
    }
    ASSERT_EQ(submaps.size(), found ? 3U : 4U);
    EXPECT_EQ(submaps[0].sweep, 105U);
    EXPECT_EQ(submaps[1].before_sweep, submaps[0].sweep) << "its reader knows it by that number";
    EXPECT_EQ(submaps[2].before_sweep, submaps[1].sweep);
  }
}

TEST(SubmapBuilder, WithoutAWayThereAreNone) {
  SubmapBuilder builder(0.0);
  EXPECT_TRUE(built(drive(40), builder).empty());
  EXPECT_FALSE(builder.finish().has_value());
}

}  // namespace
}  // namespace zloam::mapping
