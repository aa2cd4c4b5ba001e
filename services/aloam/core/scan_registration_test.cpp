// Scan registration compared with the geometry of a room, and A-LOAM's quotas.

#include "aloam/core/scan_registration.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "aloam/core/sensor_defaults.hpp"
#include "aloam/core/test_room.hpp"

namespace zloam::aloam {
namespace {

// One ring in a square room of 10 x 10 m, counter-clockwise from the middle of a wall.
PointVector square_ring(int columns, std::uint16_t ring = 0) {
  PointVector out;
  for (int i = 0; i < columns; ++i) {
    const double azimuth = 2.0 * M_PI * i / columns;
    const double range = 5.0 / std::max(std::abs(std::cos(azimuth)), std::abs(std::sin(azimuth)));
    out.push_back({static_cast<float>(range * std::cos(azimuth)),
                   static_cast<float>(range * std::sin(azimuth)), 0.0F, 7.0F,
                   static_cast<std::uint32_t>(i * 1000), ring, ReturnType::kStrongest, 0});
  }
  return out;
}

double from_corner_m(const Point& p) {
  return std::hypot(5.0 - std::abs(static_cast<double>(p.x)),
                    5.0 - std::abs(static_cast<double>(p.y)));
}

std::map<std::uint16_t, int> by_ring(const PointVector& points) {
  std::map<std::uint16_t, int> count;
  for (const Point& p : points) ++count[p.ring];
  return count;
}

TEST(ScanRegistration, SharpPointsAreTheCornersOfASquare) {
  const ScanFeatures f = extract_features(square_ring(720), 0.3);
  ASSERT_GE(f.sharp.size(), 4u);
  std::set<std::pair<bool, bool>> corners;
  for (const Point& p : f.sharp) {
    EXPECT_LT(from_corner_m(p), 0.2);
    corners.emplace(p.x > 0.0F, p.y > 0.0F);
  }
  EXPECT_EQ(corners.size(), 4u);
}

TEST(ScanRegistration, FlatPointsAreFourASegmentAndOnWalls) {
  const ScanFeatures f = extract_features(square_ring(720), 0.3);
  EXPECT_EQ(f.flat.size(), 24u);
  for (const Point& p : f.flat) EXPECT_GT(from_corner_m(p), 0.15);
}

TEST(ScanRegistration, QuotasHoldForEachRing) {
  const ScanFeatures f = extract_features(test::sweep_at(Pose::Identity(), 0.02), 0.3);
  for (const PointVector* picks : {&f.sharp, &f.less_sharp, &f.flat}) ASSERT_FALSE(picks->empty());
  for (const auto& [ring, n] : by_ring(f.sharp)) EXPECT_LE(n, 12) << ring;
  for (const auto& [ring, n] : by_ring(f.less_sharp)) EXPECT_LE(n, 120) << ring;
  for (const auto& [ring, n] : by_ring(f.flat)) EXPECT_LE(n, 24) << ring;
  EXPECT_EQ(by_ring(f.less_flat).size(), 16u);
}

TEST(ScanRegistration, PicksLieMoreThanFiveColumnsApart) {
  const ScanFeatures f = extract_features(test::sweep_at(Pose::Identity(), 0.02), 0.3);
  std::map<std::uint16_t, std::set<long>> columns;
  ASSERT_FALSE(f.less_sharp.empty());
  // A step of more than 0.22 m between neighbours ends the suppression, so the distance of five
  // columns is certain only for the dense ring below; here no column is picked twice.
  for (const Point& p : f.less_sharp) {
    const long column = std::lround(p.time_ns * 1.0 * test::kColumns / test::kPeriod_ns);
    EXPECT_TRUE(columns[p.ring].insert(column).second) << p.ring << " " << column;
  }
  const ScanFeatures square = extract_features(square_ring(720), 0.3);
  long before = -100;
  std::set<std::uint32_t> times;
  for (const Point& p : square.less_sharp) times.insert(p.time_ns / 1000);
  ASSERT_FALSE(times.empty());
  EXPECT_EQ(times.size(), square.less_sharp.size());
  for (const std::uint32_t column : times) {
    EXPECT_GT(static_cast<long>(column) - before, 5);
    before = static_cast<long>(column);
  }
}

TEST(ScanRegistration, LessFlatPointsAreOneAVoxelOfEachRing) {
  PointVector sweep = square_ring(720, 3);
  for (const Point& p : square_ring(720, 4)) sweep.push_back(p);
  const ScanFeatures f = extract_features(sweep, 0.3);
  std::set<std::tuple<int, int, int, int>> voxels;
  for (const Point& p : f.less_flat) {
    EXPECT_TRUE(voxels
                    .emplace(static_cast<int>(std::floor(p.x / 0.2F)),
                             static_cast<int>(std::floor(p.y / 0.2F)),
                             static_cast<int>(std::floor(p.z / 0.2F)), p.ring)
                    .second);
    EXPECT_FLOAT_EQ(p.intensity, 7.0F);
  }
  EXPECT_GT(f.less_flat.size(), 200u);
}

TEST(ScanRegistration, LeavesOutWhatIsNearNotFiniteOrTheWeakerReturn) {
  PointVector sweep = square_ring(720);
  const std::size_t good = sweep.size();
  Point bad = sweep.front();
  bad.x = std::numeric_limits<float>::quiet_NaN();
  sweep.push_back(bad);
  bad.x = std::numeric_limits<float>::infinity();
  sweep.push_back(bad);
  sweep.push_back({0.1F, 0.1F, 0.1F, 0.0F, 0, 0, ReturnType::kStrongest, 0});
  sweep.push_back({5.0F, 0.0F, 0.0F, 0.0F, 0, 0, ReturnType::kLast, 0});
  const ScanFeatures f = extract_features(sweep, 0.3);
  EXPECT_EQ(f.rejected, sweep.size() - good);
  EXPECT_EQ(f.sharp.size(), extract_features(square_ring(720), 0.3).sharp.size());
}

TEST(ScanRegistration, TheOnlyReturnOfAFiringIsTakenWhateverItsType) {
  PointVector sweep = square_ring(720);
  for (Point& p : sweep) p.return_type = ReturnType::kLast;
  EXPECT_EQ(extract_features(sweep, 0.3, {}, 16).rejected, sweep.size());
  EXPECT_EQ(extract_features(sweep, 0.3, {}, 16, true).rejected, 0U);
}

TEST(ScanRegistration, LeavesOutTheLowestRingsOfAnHdl64eAsReleased) {
  const SensorDefaults car = defaults_of("HDL-64E S2"), other = defaults_of("VLP-16");
  const auto rejected = [](double elevation_deg, const SensorDefaults& sensor) {
    const double rad = elevation_deg * M_PI / 180.0;
    const Point p{static_cast<float>(8.0 * std::cos(rad)),
                  0.0F,
                  static_cast<float>(8.0 * std::sin(rad)),
                  0.0F,
                  0,
                  0,
                  ReturnType::kStrongest,
                  0};
    return extract_features({&p, 1}, sensor.min_range_m, sensor.elevations).rejected;
  };
  // A-LOAM's ring of an elevation below -8.83 degrees; it uses rings 0 to 50.
  for (const double elevation_deg : {-24.0, -20.0, -18.2, -18.0, -17.0, -9.0}) {
    const int ring = 32 + static_cast<int>((-8.83 - elevation_deg) * 2.0 + 0.5);
    EXPECT_EQ(rejected(elevation_deg, car), ring > 50 ? 1u : 0u) << elevation_deg;
    EXPECT_EQ(rejected(elevation_deg, other), 0u) << elevation_deg;
  }
  EXPECT_EQ(rejected(2.1, car), 1u);
  EXPECT_EQ(rejected(1.9, car), 0u);
}

TEST(ScanRegistration, SaysThatPointsWithoutRingsHaveNoFeatures) {
  const PointVector sweep = square_ring(720);
  for (const std::uint32_t rings : {0U, 1U, 16U}) {
    const bool none = extract_features(sweep, 0.3, {}, rings).less_flat.empty();
    EXPECT_EQ(rings_error(rings, 1).empty(), !none) << rings;
  }
}

TEST(ScanRegistration, RefersAScannerOnAMotorToTheDefaultMethod) {
  // Slices have no rings; with rings of another registration the odometry can't match them, either.
  EXPECT_TRUE(rings_error(0, 20).ends_with("leave out --method"));
  EXPECT_TRUE(slices_error(20).ends_with("leave out --method"));
  for (const std::uint32_t whole : {0U, 1U}) EXPECT_EQ(slices_error(whole), "");
}

TEST(ScanRegistration, TakesAnySweep) {
  EXPECT_TRUE(extract_features({}, 0.3).less_flat.empty());
  for (int n : {1, 5, 11, 16, 17, 18}) {
    EXPECT_LE(extract_features(square_ring(n), 0.3).less_flat.size(), static_cast<std::size_t>(n));
  }
  const PointVector same(500, Point{1.0F, 1.0F, 1.0F, 0.0F, 5, 2, ReturnType::kStrongest, 0});
  const ScanFeatures f = extract_features(same, 0.3);
  EXPECT_TRUE(f.sharp.empty());
  EXPECT_EQ(f.less_flat.size(), 1u);
}

}  // namespace
}  // namespace zloam::aloam
