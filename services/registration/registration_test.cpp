#include "registration/registration.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <numbers>
#include <random>

namespace zloam::registration {
namespace {

constexpr double kDeg = std::numbers::pi / 180.0;
constexpr std::uint32_t kPeriod_ns = 100000000;

// Range along a beam at azimuth and elevation (rad); negative: no return.
using RangeModel = std::function<double(double azimuth, double elevation)>;

struct ScanModel {
  int rings = 16;
  int columns = 1800;
  double noise_m = 0.0;
  unsigned seed = 1;
  // fraction of returns lost at random
  double missing = 0.0;
};

PointVector scan(const RangeModel& range, const ScanModel& model = {}) {
  std::mt19937 rng(model.seed);
  std::normal_distribution<double> noise(0.0, 1.0);
  std::bernoulli_distribution missing(model.missing);
  PointVector points;
  for (int column = 0; column < model.columns; ++column) {
    const double azimuth = std::numbers::pi - 2.0 * std::numbers::pi * column / model.columns;
    for (int ring = 0; ring < model.rings; ++ring) {
      const double elevation =
          model.rings == 1 ? 0.0 : (-15.0 + 30.0 * ring / (model.rings - 1)) * kDeg;
      double r = range(azimuth, elevation);
      if (r <= 0.0 || missing(rng)) continue;
      r += model.noise_m * noise(rng);
      const auto time =
          static_cast<std::uint32_t>(std::uint64_t(kPeriod_ns) * column / model.columns);
      points.push_back({float(r * std::cos(elevation) * std::cos(azimuth)),
                        float(r * std::cos(elevation) * std::sin(azimuth)),
                        float(r * std::sin(elevation)), 10.0F, time, std::uint16_t(ring),
                        ReturnType::kStrongest, 0});
    }
  }
  return points;
}

// A room of half-width half_m, without floor and ceiling: four walls, four corners.
RangeModel square_room(double half_m) {
  return [half_m](double azimuth, double elevation) {
    const double flat = half_m / std::max(std::abs(std::cos(azimuth)), std::abs(std::sin(azimuth)));
    return flat / std::cos(elevation);
  };
}

RangeModel wall_ahead(double distance_m, double half_angle_deg) {
  return [=](double azimuth, double elevation) {
    return std::abs(azimuth) > half_angle_deg * kDeg
               ? -1.0
               : distance_m / (std::cos(azimuth) * std::cos(elevation));
  };
}

double corner_angle(const Point& p) {  // distance to the nearest diagonal
  const double a = std::abs(std::atan2(p.y, p.x));
  return std::min(std::abs(a - 45.0 * kDeg), std::abs(a - 135.0 * kDeg));
}

TEST(Registration, NoisyWallsGiveNoEdgesAndManyFlats) {
  RegistrationConfig config;
  for (double distance : {2.0, 5.0, 10.0, 30.0}) {
    std::size_t edges = 0;
    for (unsigned seed = 1; seed <= 10; ++seed) {
      const PointVector sweep = scan(wall_ahead(distance, 60.0), {.noise_m = 0.02, .seed = seed});
      const RegistrationResult r = extract_features(sweep, {kPeriod_ns, 16}, config);
      for (const Point& p : r.less_sharp) {
        // The ends of the wall are edges, as nothing returns beyond them.
        edges += std::abs(std::atan2(p.y, p.x)) < 59.0 * kDeg ? 1U : 0U;
      }
      EXPECT_GT(r.flat.size(), 250U) << distance;
    }
    EXPECT_LE(edges, 2U) << distance;
  }
}

TEST(Registration, ReturnsMissingAmidAWallMakeNoEdges) {
  for (double distance : {2.0, 5.0, 10.0, 30.0}) {
    std::size_t edges = 0;
    for (unsigned seed = 1; seed <= 10; ++seed) {
      const PointVector sweep =
          scan(wall_ahead(distance, 60.0), {.noise_m = 0.02, .seed = seed, .missing = 0.02});
      for (const Point& p : extract_features(sweep, {kPeriod_ns, 16}, {}).less_sharp) {
        edges += std::abs(std::atan2(p.y, p.x)) < 58.0 * kDeg ? 1U : 0U;
      }
    }
    EXPECT_LE(edges, 2U) << distance;
  }
}

TEST(Registration, TheSidesOfAGapInAWallAreEdges) {
  // Ten firings without a return at azimuth 0.
  const RangeModel wall = wall_ahead(10.0, 60.0);
  const RangeModel gap = [&](double azimuth, double elevation) {
    return std::abs(azimuth) < 1.0 * kDeg ? -1.0 : wall(azimuth, elevation);
  };
  std::size_t sides = 0;
  for (const Point& p :
       extract_features(scan(gap, {.noise_m = 0.02}), {kPeriod_ns, 16}, {}).sharp) {
    sides += std::abs(std::atan2(p.y, p.x)) < 1.3 * kDeg ? 1U : 0U;
  }
  EXPECT_EQ(sides, 32U);
}

TEST(Registration, AMissingReturnBesideAStepInDepthIsAnEdge) {
  // A panel 5 m ahead within 10 degrees, a wall 12 m ahead behind it, and no returns directly
  // beside the panel.
  const RangeModel panel = [](double azimuth, double elevation) {
    const double a = std::abs(azimuth);
    if (a > 50.0 * kDeg || (a >= 10.0 * kDeg && a < 10.3 * kDeg)) return -1.0;
    return (a < 10.0 * kDeg ? 5.0 : 12.0) / (std::cos(azimuth) * std::cos(elevation));
  };
  std::size_t near = 0;
  for (const Point& p :
       extract_features(scan(panel, {.noise_m = 0.01}), {kPeriod_ns, 16}, {}).sharp) {
    near += p.x < 6.0F ? 1U : 0U;
  }
  EXPECT_EQ(near, 32U);
}

TEST(Registration, AFixedThresholdMakesEdgesOfNoise) {
  RegistrationConfig config;
  config.edge_chi2 = 1.0;
  config.edge_min_bend_deg = 0.0;
  const PointVector sweep = scan(wall_ahead(5.0, 60.0), {.noise_m = 0.02});
  EXPECT_GT(extract_features(sweep, {kPeriod_ns, 16}, config).less_sharp.size(), 500U);
}

TEST(Registration, CornersOfARoomAreItsOnlyEdges) {
  for (double half : {4.0, 8.0, 15.0}) {
    const PointVector sweep = scan(square_room(half), {.noise_m = 0.02});
    const RegistrationResult r = extract_features(sweep, {kPeriod_ns, 16}, {});
    // Most corners of four on 16 rings: with 20 mm of noise, not every ring detects every corner.
    EXPECT_GE(r.sharp.size(), 40U) << half;
    for (const Point& p : r.sharp) {
      EXPECT_LT(corner_angle(p), 3.0 * kDeg) << half;
    }
    for (const Point& p : r.flat) {
      EXPECT_GT(corner_angle(p), 0.3 * kDeg) << half;
    }
  }
}

TEST(Registration, ObliquePlanesAreNoEdges) {
  // A wall 1.5 m to the left, seen up to 75 degrees from its normal.
  const RangeModel corridor = [](double azimuth, double elevation) {
    const double from_normal = azimuth - 90.0 * kDeg;
    return std::abs(from_normal) > 75.0 * kDeg
               ? -1.0
               : 1.5 / (std::cos(from_normal) * std::cos(elevation));
  };
  const RegistrationResult r = extract_features(scan(corridor), {kPeriod_ns, 16}, {});
  for (const Point& p : r.less_sharp) {
    EXPECT_GT(std::abs(std::atan2(p.y, p.x) - 90.0 * kDeg), 74.0 * kDeg);
  }
  EXPECT_GT(r.flat.size(), 200U);
}

TEST(Registration, FarSideOfAnOcclusionIsRejectedAndNearSideIsAnEdge) {
  // A panel 5 m ahead within 10 degrees, a wall 12 m ahead behind it.
  const RangeModel panel = [](double azimuth, double elevation) {
    const double d = std::abs(azimuth) < 10.0 * kDeg ? 5.0 : 12.0;
    return std::abs(azimuth) > 50.0 * kDeg ? -1.0 : d / (std::cos(azimuth) * std::cos(elevation));
  };
  RegistrationConfig config;
  config.drop_unreliable = true;
  const RegistrationResult r =
      extract_features(scan(panel, {.noise_m = 0.01}), {kPeriod_ns, 16}, config);
  // Six points beside each edge, on 16 rings.
  EXPECT_EQ(r.diagnostics.rejected[int(RejectReason::kOccluded)], 16U * 2U * 6U);
  for (std::size_t i = 0; i < r.rejected.size(); ++i) {
    if (r.reasons[i] == RejectReason::kOccluded) {
      EXPECT_GT(r.rejected[i].x, 11.0F);
    }
  }
  std::size_t near = 0;
  for (const Point& p : r.sharp) {
    const double a = std::abs(std::atan2(p.y, p.x));
    EXPECT_TRUE(p.x < 6.0F || a > 49.0 * kDeg) << a / kDeg;
    near += p.x < 6.0F ? 1U : 0U;
  }
  EXPECT_EQ(near, 32U);
}

TEST(Registration, SurfacesParallelToTheBeamAreRejected) {
  // A surface with a constant incidence of 85 degrees: the range grows 11.4 times as fast as the
  // arc.
  const RangeModel grazing = [](double azimuth, double elevation) {
    if (azimuth < -5.0 * kDeg || azimuth > 5.0 * kDeg) return -1.0;
    const double range = 10.0 * std::exp(11.4 * azimuth);  // logarithmic spiral
    return range / std::cos(elevation);
  };
  RegistrationConfig config;
  config.drop_unreliable = true;
  config.range_noise_m = 0.002;
  config.gap_min_m = 5.0;
  const RegistrationResult r =
      extract_features(scan(grazing, {.columns = 3600}), {kPeriod_ns, 16}, config);
  EXPECT_GT(r.diagnostics.rejected[int(RejectReason::kNearParallel)], 1000U);
  EXPECT_TRUE(r.flat.empty());
}

TEST(Registration, NoiseOfNearWallsIsNotTakenForObliqueness) {
  const PointVector sweep = scan(square_room(1.0), {.noise_m = 0.02});
  const RegistrationResult r = extract_features(sweep, {kPeriod_ns, 16}, {});
  EXPECT_LT(r.diagnostics.rejected[int(RejectReason::kNearParallel)], sweep.size() / 200);
}

TEST(Registration, QuotasHoldOnEveryRing) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> anywhere(2.0, 40.0);
  const RangeModel rubble = [&](double, double) { return anywhere(rng); };
  const RegistrationResult r = extract_features(scan(rubble), {kPeriod_ns, 16}, {});
  std::vector<int> sharp(16), less_sharp(16), flat(16);
  for (const Point& p : r.sharp) ++sharp[p.ring];
  for (const Point& p : r.less_sharp) ++less_sharp[p.ring];
  for (const Point& p : r.flat) ++flat[p.ring];
  for (std::size_t k = 0; k < 16; ++k) {
    EXPECT_LE(sharp[k], 12);
    EXPECT_LE(less_sharp[k], 120);
    EXPECT_LE(flat[k], 24);
  }
}

TEST(Registration, AQuotaOfNoneGivesNone) {
  RegistrationConfig config;
  config.less_sharp_per_segment = 0;
  config.flat_per_segment = 0;
  const auto r = extract_features(scan(square_room(8.0), {}), {kPeriod_ns, 16}, config);
  EXPECT_TRUE(r.sharp.empty());
  EXPECT_TRUE(r.less_sharp.empty());
  EXPECT_TRUE(r.flat.empty());
  EXPECT_FALSE(r.less_flat.empty());
}

TEST(Registration, EveryPointIsUsedOnceOrRejectedOnce) {
  PointVector sweep = scan(square_room(6.0), {.noise_m = 0.02});
  sweep[5].x = std::numeric_limits<float>::quiet_NaN();
  sweep[6] = {0.1F, 0.0F, 0.0F, 0, 0, 0, ReturnType::kStrongest, 0};
  sweep[7] = {500.0F, 0.0F, 0.0F, 0, 0, 0, ReturnType::kStrongest, 0};
  sweep[8].return_type = ReturnType::kLast;
  const RegistrationResult r = extract_features(sweep, {kPeriod_ns, 16}, {});
  EXPECT_EQ(r.less_sharp.size() + r.less_flat.size() + r.rejected.size(), sweep.size());
  ASSERT_EQ(r.rejected.size(), 4U);
  EXPECT_EQ(r.reasons, (std::vector{RejectReason::kNotFinite, RejectReason::kTooNear,
                                    RejectReason::kTooFar, RejectReason::kOtherReturn}));
}

TEST(Registration, VoxelFilterKeepsMeansOnTheSurface) {
  RegistrationConfig config;
  config.less_flat_leaf_m = 0.4;
  const PointVector sweep = scan(wall_ahead(5.0, 40.0));
  const RegistrationResult all = extract_features(sweep, {kPeriod_ns, 16}, {});
  const RegistrationResult few = extract_features(sweep, {kPeriod_ns, 16}, config);
  EXPECT_LT(few.less_flat.size() * 8, all.less_flat.size());
  // The wall is 2 * 5 m * tan 40 deg = 8.4 m wide, which is at least 20 voxels side by side.
  EXPECT_GE(few.less_flat.size(), 20U);
  for (const Point& p : few.less_flat) {
    EXPECT_NEAR(p.x, 5.0F, 1e-4);
  }
}

TEST(Registration, MeasuresTheRangeNoise) {
  for (double noise : {0.01, 0.03}) {
    const RegistrationResult r =
        extract_features(scan(square_room(8.0), {.noise_m = noise}), {kPeriod_ns, 16}, {});
    EXPECT_NEAR(r.diagnostics.measured_noise_m, noise, 0.1 * noise);
  }
}

TEST(Registration, WorksForManyRingCountsAndUnsortedInput) {
  for (int rings : {1, 2, 16, 32, 64, 128}) {
    const PointVector sweep = scan(square_room(8.0), {.rings = rings, .noise_m = 0.02});
    const RegistrationResult r = extract_features(sweep, {kPeriod_ns, std::uint16_t(rings)}, {});
    EXPECT_GE(r.sharp.size(), std::size_t(5 * rings / 2));
    // The sensor's ring count is only a hint.
    const RegistrationResult short_hint = extract_features(sweep, {kPeriod_ns, 1}, {});
    EXPECT_EQ(short_hint.less_flat.size(), r.less_flat.size());
  }
}

TEST(Registration, SourceWithoutTimesFindsTheSameCorners) {
  PointVector sweep = scan(square_room(8.0), {.noise_m = 0.02});
  for (Point& p : sweep) p.time_ns = 0;
  const RegistrationResult r = extract_features(sweep, {kPeriod_ns, 16}, {});
  EXPECT_GE(r.sharp.size(), 40U);
  for (const Point& p : r.sharp) EXPECT_LT(corner_angle(p), 3.0 * kDeg);
}

TEST(Registration, OddInputPassesWithAReason) {
  EXPECT_EQ(extract_features({}, {}, {}).health, Health::kEmpty);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const PointVector nans(500, Point{nan, nan, nan, 0, 0, 3, ReturnType::kStrongest, 0});
  const RegistrationResult all_nan = extract_features(nans, {}, {});
  EXPECT_EQ(all_nan.health, Health::kEmpty);
  EXPECT_EQ(all_nan.rejected.size(), 500U);
  const PointVector one(1, Point{5, 1, 0, 0, 0, 0, ReturnType::kStrongest, 0});
  EXPECT_EQ(extract_features(one, {}, {}).health, Health::kTooFewPoints);
  const PointVector same(1000, Point{5, 1, 0, 0, 7, 2, ReturnType::kStrongest, 0});
  const RegistrationResult equal = extract_features(same, {}, {});
  EXPECT_EQ(equal.less_flat.size() + equal.less_sharp.size(), 1000U);
  EXPECT_TRUE(equal.sharp.empty());
  PointVector huge(200, Point{3e38F, 3e38F, 3e38F, 0, 0, 65535, ReturnType::kStrongest, 0});
  EXPECT_EQ(extract_features(huge, {}, {}).health, Health::kEmpty);
  huge.assign(200, Point{5, 5, 5, 0, 0, 65535, ReturnType::kStrongest, 0});
  EXPECT_EQ(extract_features(huge, {0, 0}, {}).diagnostics.points_used, 200U);
}

TEST(Registration, SameInputSameBytes) {
  const PointVector sweep = scan(square_room(7.0), {.noise_m = 0.02});
  const RegistrationResult a = extract_features(sweep, {kPeriod_ns, 16}, {});
  const RegistrationResult b = extract_features(sweep, {kPeriod_ns, 16}, {});
  const auto same = [](const PointVector& p, const PointVector& q) {
    return p.size() == q.size() && std::memcmp(p.data(), q.data(), p.size() * sizeof(Point)) == 0;
  };
  EXPECT_TRUE(same(a.sharp, b.sharp) && same(a.less_sharp, b.less_sharp));
  EXPECT_TRUE(same(a.flat, b.flat) && same(a.less_flat, b.less_flat));
}

// All points are less flat, and the elevation replaces the ring, whatever ring the point has.
TEST(Registration, WithoutRingsTheElevationStandsForThem) {
  const PointVector ringed = scan(square_room(7.0), {.noise_m = 0.02});
  PointVector sweep = ringed;
  for (Point& p : sweep) p.ring = 7;
  sweep.push_back({0.1F, 0.0F, 0.0F, 1.0F, 0, 0, ReturnType::kStrongest, 0});
  const RegistrationResult result = extract_features(sweep, {kPeriod_ns, 0}, {});
  EXPECT_EQ(result.health, Health::kOk);
  EXPECT_TRUE(result.sharp.empty() && result.less_sharp.empty() && result.flat.empty());
  ASSERT_EQ(result.less_flat.size(), ringed.size());
  ASSERT_EQ(result.reasons, std::vector{RejectReason::kTooNear});
  const RegistrationResult with = extract_features(ringed, {kPeriod_ns, 16}, {});
  std::map<std::uint16_t, std::size_t> lines, rings;
  for (const Point& p : result.less_flat) ++lines[p.ring];
  for (const Point& p : ringed) ++rings[p.ring];
  ASSERT_EQ(lines.size(), rings.size());
  auto line = lines.begin();
  for (const auto& [ring, count] : rings) EXPECT_EQ((line++)->second, count) << "ring " << ring;
  EXPECT_EQ(with.diagnostics.points_used, result.diagnostics.points_used);
}

// In the mode "last" each firing has one return, of this type.
TEST(Registration, TheOnlyReturnOfAFiringIsUsedWhateverItsType) {
  RegistrationConfig config;
  PointVector sweep = scan(square_room(7.0), {.noise_m = 0.02});
  for (const ReturnType type : {ReturnType::kStrongest, ReturnType::kLast}) {
    for (Point& p : sweep) p.return_type = type;
    for (const auto returns : {ReturnSelection::kStrongest, ReturnSelection::kLast}) {
      config.returns = returns;
      const SweepInfo alone{.period_ns = kPeriod_ns, .rings = 16, .one_return = true};
      EXPECT_EQ(extract_features(sweep, alone, config).diagnostics.points_used, sweep.size());
      const bool wanted =
          (type == ReturnType::kStrongest) == (returns == ReturnSelection::kStrongest);
      EXPECT_EQ(extract_features(sweep, {kPeriod_ns, 16}, config).diagnostics.points_used,
                wanted ? sweep.size() : 0U);
    }
  }
}

TEST(Registration, WithoutRingsTheVoxelFilterFiltersAsWell) {
  RegistrationConfig config;
  config.less_flat_leaf_m = 0.4;
  const PointVector sweep = scan(wall_ahead(5.0, 40.0));
  const RegistrationResult all = extract_features(sweep, {kPeriod_ns, 0}, {});
  const RegistrationResult few = extract_features(sweep, {kPeriod_ns, 0}, config);
  ASSERT_EQ(all.less_flat.size(), sweep.size());
  EXPECT_LT(few.less_flat.size() * 8, all.less_flat.size());
  // The wall is 2 * 5 m * tan 40 deg = 8.4 m wide, which is at least 20 voxels side by side.
  EXPECT_GE(few.less_flat.size(), 20U);
  for (const Point& p : few.less_flat) EXPECT_NEAR(p.x, 5.0F, 1e-4);
}

TEST(Registration, WithoutRingsTooFewPointsAreTooFew) {
  PointVector sweep = scan(square_room(7.0));
  sweep.resize(20);
  EXPECT_EQ(extract_features(sweep, {kPeriod_ns, 0}, {}).health, Health::kTooFewPoints);
  EXPECT_EQ(extract_features({}, {kPeriod_ns, 0}, {}).health, Health::kEmpty);
}

}  // namespace
}  // namespace zloam::registration
