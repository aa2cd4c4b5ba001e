#include "driver/scan/scan.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

namespace zloam::driver {
namespace {

constexpr ScanTiming kClockwise{TimeModel::kClockwise, 0.1, 180.0};

/// Writes rings of an HDL-64E from the top, each from azimuth 0 counter-clockwise.
struct KittiWriter {
  std::vector<float> values;
  std::vector<int> from_top;

  void add(int ring, double azimuth_deg, double range_m = 20.0) {
    const double elevation_deg = ring < 32 ? 2.0 - ring / 3.0 : -8.83 - 0.5 * (ring - 32);
    const double e = elevation_deg * M_PI / 180.0;
    const double a = azimuth_deg * M_PI / 180.0;
    for (const double v : {range_m * std::cos(e) * std::cos(a), range_m * std::cos(e) * std::sin(a),
                           range_m * std::sin(e), 0.4}) {
      values.push_back(static_cast<float>(v));
    }
    from_top.push_back(ring);
  }
  void add_ring(int ring, double from_deg = 0.05, double to_deg = 359.95, double step = 0.5) {
    for (double a = from_deg; a < to_deg; a += step) add(ring, a);
  }
};

void expect_rings(const KittiWriter& scan, int rings) {
  int found = 0;
  const auto got = recover_rings(scan.values, found);
  EXPECT_EQ(found, rings);
  ASSERT_EQ(got.size(), scan.from_top.size());
  for (std::size_t i = 0; i < got.size(); ++i) {
    ASSERT_EQ(got[i], scan.from_top[i] - scan.from_top[0]) << i;
  }
}

TEST(Kitti, FindsRingsOfAWholeScan) {
  KittiWriter scan;
  for (int r = 0; r < 64; ++r) scan.add_ring(r);
  expect_rings(scan, 64);
}

TEST(Kitti, FindsRingsWithHolesAndJitterAtTheStart) {
  KittiWriter scan;
  scan.add_ring(0, 10.0, 40.0);
  scan.add_ring(0, 300.0, 350.0);
  scan.add(1, 359.98);
  scan.add(1, 0.02);
  scan.add(1, 359.99);
  scan.add_ring(1, 0.3, 359.9);
  scan.add_ring(2, 0.1, 200.0);
  scan.add_ring(3, 90.0, 359.0);
  scan.add_ring(4, 5.0, 359.0);
  int found = 0;
  const auto ring = recover_rings(scan.values, found);
  EXPECT_EQ(found, 5);
  // The two points just below azimuth 0 may belong to either ring; all others are certain.
  for (std::size_t i = 0; i < ring.size(); ++i) {
    const double azimuth = std::atan2(scan.values[4 * i + 1], scan.values[4 * i]);
    if (std::abs(azimuth) < 1e-3) continue;
    ASSERT_EQ(ring[i], scan.from_top[i]) << i;
  }
}

TEST(Kitti, RingsAreByAscendingElevationAlsoWhenTheTopIsMissing) {
  KittiWriter scan;
  for (int r = 5; r < 64; ++r) scan.add_ring(r);
  const DecodedSweep sweep = kitti_sweep(scan.values, kClockwise, 0);
  EXPECT_EQ(sweep.rings, 64);
  for (const Point& p : sweep.points) {
    const double elevation_deg = std::atan2(p.z, std::hypot(p.x, p.y)) * 180.0 / M_PI;
    const int from_top = 63 - p.ring;
    const double nominal = from_top < 32 ? 2.0 - from_top / 3.0 : -8.83 - 0.5 * (from_top - 32);
    ASSERT_NEAR(elevation_deg, nominal, 1e-3);
  }
}

TEST(Kitti, TimesFollowTheDeclaredTurn) {
  KittiWriter scan;
  for (const double azimuth : {0.0, 90.0, 179.0, 181.0, 270.0}) scan.add(0, azimuth);
  const DecodedSweep sweep = kitti_sweep(scan.values, kClockwise, 5'000'000'000);
  ASSERT_EQ(sweep.points.size(), 5U);
  // Clockwise from the rear: first the left side, then the front, then the right side.
  const double expected_ns[] = {1.0 / 360, 90.0 / 360, 180.0 / 360, 270.0 / 360, 359.0 / 360};
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_NEAR(static_cast<double>(sweep.stamp_ns + sweep.points[i].time_ns) - 5e9,
                expected_ns[i] * 1e8, 20.0);
  }
  EXPECT_GT(sweep.points[1].y, 19.0F);
  EXPECT_EQ(sweep.points.front().time_ns, 0U);
  EXPECT_EQ(sweep.period_ns, 100'000'000U);
  EXPECT_NEAR(sweep.points[0].intensity, 102.0, 1e-3);

  const ScanTiming other{TimeModel::kCounterClockwise, 0.2, 0.0};
  const DecodedSweep reversed = kitti_sweep(scan.values, other, 0);
  EXPECT_NEAR(reversed.points.back().time_ns, 270.0 / 360 * 2e8, 40.0);
}

TEST(Kitti, DeskewedScansHaveNoTimes) {
  KittiWriter scan;
  scan.add_ring(0);
  const DecodedSweep sweep = kitti_sweep(scan.values, {TimeModel::kDeskewed, 0.1, 180.0}, 7);
  EXPECT_TRUE(sweep.deskewed);
  for (const Point& p : sweep.points) ASSERT_EQ(p.time_ns, 0U);
}

TEST(Kitti, ZeroAndBrokenPointsAreNoReturns) {
  KittiWriter scan;
  scan.add_ring(0);
  const std::size_t good = scan.from_top.size();
  for (const float v : {0.0F, 0.0F, 0.0F, 0.0F}) scan.values.push_back(v);
  for (const float v : {std::numeric_limits<float>::quiet_NaN(), 1.0F, 1.0F, 0.0F}) {
    scan.values.push_back(v);
  }
  KittiDiagnostics diagnostics;
  const DecodedSweep sweep = kitti_sweep(scan.values, kClockwise, 0, &diagnostics);
  EXPECT_EQ(sweep.points.size(), good);
  EXPECT_EQ(diagnostics.dropped_zero_range, 1U);
  EXPECT_EQ(diagnostics.dropped_not_finite, 1U);
  EXPECT_EQ(diagnostics.rings_found, 1);
}

TEST(Kitti, EmptyAndSinglePointScansPass) {
  EXPECT_TRUE(kitti_sweep({}, kClockwise, 0).points.empty());
  KittiWriter scan;
  scan.add(0, 10.0);
  EXPECT_EQ(kitti_sweep(scan.values, kClockwise, 0).points.size(), 1U);
}

TEST(Synth, ReadsRecords) {
  std::vector<std::byte> bytes(32, std::byte{0});
  const float first[] = {1.0F, 2.0F, 3.0F};
  std::memcpy(bytes.data(), first, 12);
  bytes[12] = std::byte{77};
  bytes[13] = std::byte{9};
  bytes[14] = std::byte{3};
  std::memcpy(bytes.data() + 16, first, 12);
  bytes[29] = std::byte{2};
  bytes[30] = std::byte{0x10};
  bytes[31] = std::byte{0x27};
  const auto sweep = synth_sweep(bytes, 1'000'000'000, 1'100'000'000);
  ASSERT_TRUE(sweep);
  ASSERT_EQ(sweep->points.size(), 2U);
  EXPECT_EQ(sweep->stamp_ns, 1'000'006'000);
  EXPECT_EQ(sweep->points[0].ring, 9);
  EXPECT_EQ(sweep->points[0].intensity, 77.0F);
  EXPECT_EQ(sweep->points[1].time_ns, 20'000'000U - 6'000U);
  EXPECT_EQ(sweep->period_ns, 100'000'000U);
  EXPECT_EQ(sweep->columns[1], 361);
  EXPECT_FALSE(synth_sweep(std::span(bytes).first(17), 0, 0));
  EXPECT_TRUE(synth_sweep({}, 0, 0)->points.empty());
}

}  // namespace
}  // namespace zloam::driver
