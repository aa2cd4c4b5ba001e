// Published test vectors, computed by the manuals' formulas and checked against an independent
// decoder; z includes the vertical offset.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "driver/velodyne/test_decoding.hpp"

namespace zloam::driver::velodyne {
namespace {

using test::azimuth_steps;
using test::decode_all;
using test::make_payload;
using test::Payload;

struct Expected {
  int ring;
  double time_us;
  double x, y, z;
  int intensity;
  ReturnType type;
};

void expect_points(const Payload& payload, std::uint32_t crc,
                   const std::vector<Expected>& expected) {
  ASSERT_EQ(test::crc32(payload), crc) << "the input is not the published one";
  Decoder decoder({});
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), expected.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    SCOPED_TRACE(i);
    EXPECT_EQ(points[i].ring, expected[i].ring);
    EXPECT_NEAR(points[i].time_ns, 1000.0 * expected[i].time_us, 1.0);
    EXPECT_NEAR(points[i].x, expected[i].x, 1e-5);
    EXPECT_NEAR(points[i].y, expected[i].y, 1e-5);
    EXPECT_NEAR(points[i].z, expected[i].z, 1e-5);
    EXPECT_EQ(points[i].intensity, static_cast<float>(expected[i].intensity));
    EXPECT_EQ(points[i].return_type, expected[i].type);
  }
}

constexpr ReturnType kStrongest = ReturnType::kStrongest;
constexpr ReturnType kLast = ReturnType::kLast;

TEST(Decoder, V1Vlp16Strongest) {
  const Payload payload = make_payload(azimuth_steps(1000, 40),
                                       {{0, 0, {0x88, 0x13, 0x64}},
                                        {0, 15, {0x88, 0x13, 0x07}},
                                        {0, 16, {0x88, 0x13, 0xff}},
                                        {5, 5, {0x39, 0x30, 0x21}},
                                        {11, 31, {0xe8, 0x03, 0x01}}},
                                       {0xd2, 0x02, 0x96, 0x49, 0x37, 0x22});
  expect_points(payload, 0xaf998e6d,
                {{0, 0.000, 9.512512, -1.677313, -2.576990, 100, kStrongest},
                 {15, 34.560, 9.508830, -1.698062, 2.576990, 7, kStrongest},
                 {0, 55.296, 9.506600, -1.710507, -2.576990, 255, kStrongest},
                 {10, 564.480, 24.054839, -5.131300, 2.148175, 33, kStrongest},
                 {15, 1306.368, 1.868404, -0.491038, 0.506438, 1, kStrongest}});
}

TEST(Decoder, V2Vlp16LastWithWrapInsideThePacket) {
  const Payload payload = make_payload(
      azimuth_steps(35900, 40),
      {{2, 0, {0x10, 0x27, 0x0a}}, {2, 31, {0x10, 0x27, 0x14}}, {3, 16, {0x10, 0x27, 0x1e}}},
      {0x9c, 0xa3, 0x93, 0xd6, 0x38, 0x22});
  expect_points(payload, 0x97793e2f,
                {{0, 221.184, 19.318399, 0.067434, -5.165181, 10, kLast},
                 {15, 311.040, 19.318471, -0.042146, 5.165181, 20, kLast},
                 {0, 387.072, 19.318046, -0.134868, -5.165181, 30, kLast}});
}

TEST(Decoder, V3Vlp16DualEmitsEqualDistancesOnce) {
  const Payload payload = make_payload(azimuth_steps(1000, 40, true),
                                       {{4, 3, {0x20, 0x4e, 0x32}},
                                        {5, 3, {0x40, 0x1f, 0xc8}},
                                        {4, 20, {0xb8, 0x0b, 0x09}},
                                        {5, 20, {0xb8, 0x0b, 0x09}},
                                        {11, 31, {0x70, 0x17, 0x42}}},
                                       {0x20, 0xa1, 0x07, 0x00, 0x39, 0x22});
  expect_points(payload, 0x86ff597b,
                {{9, 228.096, 39.234373, -7.502101, 2.091238, 50, kLast},
                 {9, 228.096, 15.693749, -3.000840, 0.835175, 200, kStrongest},
                 {2, 285.696, 5.780897, -1.127183, -1.136754, 9, ReturnType::kBoth},
                 {15, 642.816, 11.323964, -2.474200, 3.094629, 66, kStrongest}});
}

TEST(Decoder, V4PuckHiRes) {
  const Payload payload = make_payload(azimuth_steps(9000, 20),
                                       {{1, 1, {0x10, 0x27, 0x05}}, {1, 30, {0x10, 0x27, 0x06}}},
                                       {0x2a, 0x00, 0x00, 0x00, 0x37, 0x24});
  expect_points(payload, 0xcee52dd5,
                {{8, 112.896, -0.071263, -19.998519, 0.231805, 5, kStrongest},
                 {7, 198.144, -0.125073, -19.998255, -0.231805, 6, kStrongest}});
}

TEST(Decoder, H1Hdl32e) {
  const Payload payload = make_payload(
      azimuth_steps(0, 17),
      {{0, 0, {0x88, 0x13, 0x01}}, {3, 15, {0xa8, 0x61, 0x02}}, {11, 31, {0x10, 0x27, 0x03}}},
      {0x40, 0x42, 0x0f, 0x00, 0x37, 0x21});
  expect_points(payload, 0x1483d12e,
                {{0, 0.000, 8.601195, 0.0, -5.083756, 1, kStrongest},
                 {23, 155.520, 49.997493, -0.500683, 0.0, 2, kStrongest},
                 {31, 542.592, 19.642204, -0.686522, 3.697592, 3, kStrongest}});
}

TEST(Decoder, H2Hdl32eDual) {
  const Payload payload = make_payload(azimuth_steps(9000, 17, true),
                                       {{2, 7, {0x10, 0x27, 0x04}}, {3, 7, {0x88, 0x13, 0x05}}},
                                       {0x40, 0x42, 0x0f, 0x00, 0x39, 0x21});
  expect_points(payload, 0xa6aee751,
                {{19, 54.144, -0.069424, -19.913403, -1.855139, 4, kLast},
                 {19, 54.144, -0.034712, -9.956701, -0.926219, 5, kStrongest}});
}

TEST(Decoder, C1Vlp32c) {
  const Payload payload = make_payload(azimuth_steps(0, 20),
                                       {{0, 0, {0xc4, 0x09, 0x01}},
                                        {0, 1, {0xc4, 0x09, 0x02}},
                                        {4, 29, {0x10, 0x27, 0x03}},
                                        {11, 31, {0xc4, 0x09, 0x04}}},
                                       {0x4d, 0x00, 0x00, 0x00, 0x37, 0x28});
  expect_points(payload, 0x0917d143,
                {{0, 0.000, 9.060372, -0.221431, -4.206411, 1, kStrongest},
                 {17, 0.000, 9.971626, 0.732270, -0.173784, 2, kStrongest},
                 {31, 253.440, 38.635658, 0.325929, 10.341401, 3, kStrongest},
                 {16, 642.816, 9.995991, -0.161392, -0.231645, 4, kStrongest}});
}

TEST(Decoder, C2Vlp32cDual) {
  const Payload payload = make_payload(azimuth_steps(27000, 20, true),
                                       {{6, 5, {0x10, 0x27, 0x09}}, {7, 5, {0xa0, 0x0f, 0x63}}},
                                       {0x4d, 0x00, 0x00, 0x00, 0x39, 0x28});
  expect_points(payload, 0x0881c318,
                {{20, 170.496, -0.546853, 39.996262, 0.0, 9, kLast},
                 {20, 170.496, -0.218741, 15.998505, 0.0, 99, kStrongest}});
}

/// Single returns: three firings of four banks, each bank with its own flag.
Payload vls128_payload(const std::array<int, 3>& azimuths_cdeg, std::uint32_t toh_us,
                       const std::vector<test::CellBytes>& cells) {
  std::vector<int> azimuths;
  for (int k = 0; k < kBlocksPerPacket; ++k) azimuths.push_back(azimuths_cdeg[k / 4]);
  Payload payload = make_payload(azimuths, cells,
                                 {static_cast<std::uint8_t>(toh_us),
                                  static_cast<std::uint8_t>(toh_us >> 8), 0, 0, 0x37, 0xa1});
  constexpr std::array<std::uint8_t, 4> kFlags = {0xEE, 0xDD, 0xCC, 0xBB};
  for (std::size_t k = 0; k < kBlocksPerPacket; ++k) payload[100 * k + 1] = kFlags[k % 4];
  return payload;
}

// The cells are in the second packet, so its CRC is the second one published.
TEST(Decoder, A1Vls128) {
  const Payload payload = vls128_payload(
      {60, 80, 100}, 1173,
      {{0, 0, {0xc4, 0x09, 0x01}}, {2, 0, {0xc4, 0x09, 0x02}}, {7, 31, {0x10, 0x27, 0x03}}});
  EXPECT_EQ(test::crc32(payload), 0xda9372e7U);
  Decoder decoder({});
  const PacketTail tail = decoder.tail(payload);
  ASSERT_EQ(tail.reject, Reject::kNone);
  const PacketPlan plan = decoder.plan(payload, tail.mode);
  ASSERT_EQ(plan.groups, 3);
  EXPECT_EQ(plan.bad_blocks, 0);
  struct Row {
    int group;
    int ring;
    double time_us, x, y, z;
  };
  std::vector<Point> out(decoder.most_points_per_group(ReturnMode::kDual) + 1);
  std::vector<std::uint16_t> columns(out.size());
  const std::vector<Row> rows = {{0, 4, -7.0, 9.71872, -1.18539, -2.02286},
                                 {0, 20, 21.9, 9.87661, -1.22214, -0.97353},
                                 {1, 75, 99.93, 39.82241, 3.75311, 0.29975}};
  std::size_t row = 0;
  for (int g = 0; g < plan.groups; ++g) {
    const PlacedGroup placed{g, 0, 0};
    const std::size_t count = decoder.decode_groups(plan, {&placed, 1}, out.data(), columns.data());
    for (std::size_t i = 0; i < count; ++i, ++row) {
      ASSERT_LT(row, rows.size());
      SCOPED_TRACE(row);
      EXPECT_EQ(g, rows[row].group);
      EXPECT_EQ(out[i].ring, rows[row].ring);
      EXPECT_NEAR(1e-3 * static_cast<double>(plan.group[g].offset_ns + out[i].time_ns),
                  rows[row].time_us, 1e-3);
      EXPECT_NEAR(out[i].x, rows[row].x, 2e-5);
      EXPECT_NEAR(out[i].y, rows[row].y, 2e-5);
      EXPECT_NEAR(out[i].z, rows[row].z, 2e-5);
    }
  }
  EXPECT_EQ(row, rows.size());
}

TEST(Decoder, BanksAreByTheFlagNotByThePlace) {
  const std::vector<test::CellBytes> cells = {{0, 0, {0xc4, 0x09, 0x01}},
                                              {2, 0, {0xc4, 0x09, 0x02}}};
  const Payload usual = vls128_payload({60, 80, 100}, 1173, cells);
  Payload moved = usual;
  // Swaps blocks 0 and 2.
  std::swap_ranges(moved.begin(), moved.begin() + 100, moved.begin() + 200);
  Decoder a({});
  Decoder b({});
  const auto expected = decode_all(a, usual);
  const auto got = decode_all(b, moved);
  ASSERT_EQ(got.size(), 2U);
  for (std::size_t i = 0; i < got.size(); ++i) {
    EXPECT_EQ(got[i].ring, expected[i].ring);
    EXPECT_EQ(got[i].time_ns, expected[i].time_ns);
    EXPECT_EQ(got[i].x, expected[i].x);
  }
}

/// Two returns: a pair of blocks for each bank, and four unused blocks.
Payload vls128_dual_payload(int azimuth_cdeg, std::uint32_t toh_us,
                            const std::vector<test::CellBytes>& cells) {
  Payload payload = vls128_payload({azimuth_cdeg, azimuth_cdeg, azimuth_cdeg}, toh_us, cells);
  constexpr std::array<std::uint8_t, 4> kFlags = {0xEE, 0xDD, 0xCC, 0xBB};
  for (std::size_t k = 0; k < 8; ++k) payload[100 * k + 1] = kFlags[k / 2];
  std::fill(payload.begin() + 800, payload.begin() + 1200, 0);
  payload[1204] = 0x39;
  return payload;
}

TEST(Decoder, Vls128DualTakesItsSpeedFromTheLastPackets) {
  Decoder decoder({});
  // At 600 rpm the azimuth advances by 20.808 hundredths of a degree in a firing of 57.8 us.
  std::vector<Point> points;
  for (int i = 0; i < 20; ++i) {
    const Payload payload = vls128_dual_payload(
        static_cast<int>(20.808 * i), static_cast<std::uint32_t>(1000 + 57.8 * i),
        {{6, 31, {0xc4, 0x09, 0x01}}, {7, 31, {0x10, 0x27, 0x02}}});
    const PacketTail tail = decoder.tail(payload);
    const PacketPlan plan = decoder.plan(payload, tail.mode);
    EXPECT_EQ(plan.groups, 1);
    EXPECT_EQ(plan.bad_blocks, 0) << "the last four blocks have no meaning";
    if (i > 0) {
      EXPECT_NEAR(plan.advance_cdeg, 20.808, 1.1);
    }
    points = decode_all(decoder, payload);
  }
  ASSERT_EQ(points.size(), 2U);
  EXPECT_EQ(points[0].return_type, kLast);
  EXPECT_EQ(points[1].return_type, kStrongest);
  EXPECT_EQ(points[0].ring, points[1].ring);
  EXPECT_NEAR(points[0].position().norm(), 10.0, 0.01);
  EXPECT_NEAR(points[1].position().norm(), 40.0, 0.01);
}

TEST(Decoder, Vls128DualKeepsItsSpeedThroughAnOutage) {
  Decoder decoder({});
  for (int i = 0; i < 4000; ++i) {
    // 150 ms, a turn and a half, or a third of the speed if the whole turn is not counted.
    const int fired = i < 500 ? i : i + 2595;
    const auto toh_us = static_cast<std::uint32_t>(1000.0 + 57.8 * fired);
    const auto azimuth_cdeg = static_cast<int>(std::fmod(20.808 * fired, kTurnCdeg));
    Payload payload = vls128_dual_payload(azimuth_cdeg, toh_us & 0xFFFF, {});
    payload[1202] = static_cast<std::uint8_t>(toh_us >> 16);
    const PacketPlan plan = decoder.plan(payload, decoder.tail(payload).mode);
    if (i > 0) {
      ASSERT_NEAR(plan.advance_cdeg, 20.808, 1.3) << i;
    }
  }
}

}  // namespace
}  // namespace zloam::driver::velodyne
