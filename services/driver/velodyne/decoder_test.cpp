#include "driver/velodyne/decoder.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "driver/velodyne/test_decoding.hpp"

namespace zloam::driver::velodyne {
namespace {

using test::azimuth_steps;
using test::decode_all;
using test::make_payload;
using test::Payload;

constexpr ReturnType kStrongest = ReturnType::kStrongest;
constexpr ReturnType kLast = ReturnType::kLast;

TEST(Decoder, DualReturnPolicies) {
  // Channel 3: last 40 m, strongest 16 m; 5: equal; 7: last only; 9: strongest only.
  const Payload payload = make_payload(azimuth_steps(1000, 40, true),
                                       {{4, 3, {0x20, 0x4e, 50}},
                                        {5, 3, {0x40, 0x1f, 200}},
                                        {4, 5, {0xb8, 0x0b, 9}},
                                        {5, 5, {0xb8, 0x0b, 9}},
                                        {4, 7, {0x70, 0x17, 66}},
                                        {5, 9, {0x70, 0x17, 67}}},
                                       {0, 0, 0, 0, 0x39, 0x22});
  using Expect = std::vector<std::pair<int, ReturnType>>;
  const auto decoded = [&](DualReturns policy) {
    Decoder decoder({.dual_returns = policy});
    Expect got;
    for (const Point& p : decode_all(decoder, payload)) {
      got.emplace_back(static_cast<int>(p.intensity), p.return_type);
    }
    return got;
  };
  constexpr ReturnType kBoth = ReturnType::kBoth;
  EXPECT_EQ(decoded(DualReturns::kTagged),
            (Expect{{50, kLast}, {200, kStrongest}, {9, kBoth}, {66, kLast}, {67, kStrongest}}));
  EXPECT_EQ(decoded(DualReturns::kBoth),
            (Expect{{50, kBoth}, {200, kBoth}, {9, kBoth}, {66, kBoth}, {67, kBoth}}));
  EXPECT_EQ(decoded(DualReturns::kStrongest),
            (Expect{{200, kStrongest}, {9, kBoth}, {66, kBoth}, {67, kStrongest}}));
  EXPECT_EQ(decoded(DualReturns::kLast),
            (Expect{{50, kBoth}, {9, kBoth}, {66, kBoth}, {67, kBoth}}));
}

TEST(Decoder, RangeLimitsBelongToTheRange) {
  // 0.998, 1.000, 50.000 and 50.002 m.
  const Payload payload = make_payload(azimuth_steps(1000, 40),
                                       {{0, 0, {0xf3, 0x01, 1}},
                                        {0, 1, {0xf4, 0x01, 2}},
                                        {0, 2, {0xa8, 0x61, 3}},
                                        {0, 3, {0xa9, 0x61, 4}}},
                                       {0, 0, 0, 0, 0x37, 0x22});
  Decoder decoder({.min_range_m = 1.0, .max_range_m = 50.0});
  const auto points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 2U);
  EXPECT_EQ(points[0].intensity, 2.0F);
  EXPECT_EQ(points[1].intensity, 3.0F);
}

TEST(Decoder, ReflectivityZeroIsAReturnAndDistanceZeroIsNone) {
  const Payload payload =
      make_payload(azimuth_steps(1000, 40), {{0, 0, {0x88, 0x13, 0}}, {0, 1, {0, 0, 99}}},
                   {0, 0, 0, 0, 0x37, 0x22});
  Decoder decoder({});
  const auto points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_EQ(points[0].intensity, 0.0F);
}

// Between 359.99 and 360 degrees, a table indexed by the rounded azimuth could be exceeded.
TEST(Decoder, NothingHappensAtTheEndOfTheTurn) {
  const Payload payload =
      make_payload(azimuth_steps(35997, 40), {{0, 15, {0x88, 0x13, 1}}, {0, 31, {0x88, 0x13, 2}}},
                   {0, 0, 0, 0, 0x37, 0x22});
  Decoder decoder({});
  const auto points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 2U);
  // 359.97 degrees, plus 0.40 degrees times the firing's fraction of the block's time.
  for (std::size_t i = 0; i < 2; ++i) {
    const double share = (34.56 + 55.296 * static_cast<double>(i)) / 110.592;
    const double expected_deg = -0.03 + 0.40 * share;
    EXPECT_NEAR(std::atan2(-points[i].y, points[i].x) * 180.0 / M_PI, expected_deg, 1e-4);
  }
}

TEST(Decoder, VerticalOffsetsCanBeLeftOut) {
  const Payload payload = make_payload(azimuth_steps(1000, 40), {{0, 0, {0x88, 0x13, 0x64}}},
                                       {0xd2, 0x02, 0x96, 0x49, 0x37, 0x22});
  Decoder decoder({.vertical_offsets = false});
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_NEAR(points[0].z, -2.588190, 1e-5);
}

TEST(Decoder, RingsAreByAscendingElevation) {
  for (const Model model :
       {Model::kVlp16, Model::kPuckHiRes, Model::kHdl32e, Model::kVlp32c, Model::kVls128}) {
    const ModelTable& table = model_table(model);
    for (const Channel& a : table.channels) {
      ASSERT_LT(a.ring, table.rings);
      for (const Channel& b : table.channels) {
        ASSERT_EQ(a.ring < b.ring, a.elevation_deg < b.elevation_deg) << table.label;
      }
    }
  }
}

TEST(Decoder, RefusesWhatIsNoDataPacket) {
  Decoder decoder({});
  const Payload good = make_payload(azimuth_steps(0, 40), {}, {0, 0, 0, 0, 0x37, 0x22});
  std::vector<std::uint8_t> payload(good.begin(), good.end());
  payload.resize(1205);
  EXPECT_EQ(decoder.tail(payload).reject, Reject::kShort);
  payload.resize(1207);
  EXPECT_EQ(decoder.tail(payload).reject, Reject::kForeign);
  EXPECT_EQ(decoder.tail({}).reject, Reject::kForeign);
  Payload late = make_payload(azimuth_steps(0, 40), {}, {0xff, 0xff, 0xff, 0xff, 0x37, 0x22});
  EXPECT_EQ(decoder.tail(late).reject, Reject::kBadTime);
  Payload mode = make_payload(azimuth_steps(0, 40), {}, {0, 0, 0, 0, 0x42, 0x22});
  EXPECT_EQ(decoder.tail(mode).reject, Reject::kUnknownMode);
  ASSERT_EQ(decoder.contradictions().size(), 1U);
  EXPECT_NE(decoder.contradictions()[0].find("0x42"), std::string::npos);
}

TEST(Decoder, UnknownModelIsRefusedByNameOfTheByte) {
  Decoder decoder({});
  const Payload velarray = make_payload(azimuth_steps(0, 40), {}, {0, 0, 0, 0, 0x37, 0x31});
  EXPECT_EQ(decoder.tail(velarray).reject, Reject::kUnknownModel);
  ASSERT_EQ(decoder.contradictions().size(), 1U);
  EXPECT_NE(decoder.contradictions()[0].find("Velarray"), std::string::npos);
}

TEST(Decoder, AnotherModelInTheStreamIsAStranger) {
  Decoder decoder({});
  const Payload vlp16 = make_payload(azimuth_steps(0, 40), {}, {0, 0, 0, 0, 0x37, 0x22});
  const Payload hdl32e = make_payload(azimuth_steps(0, 40), {}, {0, 0, 0, 0, 0x37, 0x21});
  EXPECT_EQ(decoder.tail(vlp16).reject, Reject::kNone);
  EXPECT_EQ(decoder.tail(hdl32e).reject, Reject::kModelMismatch);
}

TEST(Decoder, ForcedReturnModeDecodesAndNamesTheContradiction) {
  // Old firmware sends no mode byte. A mode byte that differs from the configured mode is reported.
  const Payload old = make_payload(azimuth_steps(1000, 40), {}, {0, 0, 0, 0, 0x00, 0x00});
  Decoder forced({.model = Model::kVlp16, .return_mode = ReturnMode::kLast});
  EXPECT_EQ(forced.tail(old).reject, Reject::kNone);
  EXPECT_EQ(forced.tail(old).mode, ReturnMode::kLast);
  EXPECT_TRUE(forced.contradictions().empty());
  const Payload other = make_payload(azimuth_steps(1000, 40), {}, {0, 0, 0, 0, 0x37, 0x22});
  EXPECT_EQ(forced.tail(other).mode, ReturnMode::kLast);
  ASSERT_EQ(forced.contradictions().size(), 1U);
  EXPECT_NE(forced.contradictions()[0].find("strongest"), std::string::npos);
}

TEST(Decoder, ForcedModelDecodesAndNamesTheContradiction) {
  Decoder decoder({.model = Model::kVlp16});
  const Payload payload = make_payload(azimuth_steps(1000, 40), {{0, 15, {0x88, 0x13, 0x07}}},
                                       {0, 0, 0, 0, 0x37, 0x21});
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_EQ(points[0].time_ns, 34560U);
  ASSERT_EQ(decoder.contradictions().size(), 1U);
  EXPECT_NE(decoder.contradictions()[0].find("HDL-32E"), std::string::npos);
}

TEST(Decoder, ABadBlockIsSkippedAndTheRestKept) {
  Payload payload =
      make_payload(azimuth_steps(1000, 40), {{3, 0, {0x88, 0x13, 1}}, {4, 0, {0x88, 0x13, 2}}},
                   {0, 0, 0, 0, 0x37, 0x22});
  payload[300] = 0x12;
  Decoder decoder({});
  const PacketPlan plan = decoder.plan(payload, decoder.tail(payload).mode);
  EXPECT_EQ(plan.bad_blocks, 1);
  EXPECT_FALSE(plan.group[3].valid);
  EXPECT_DOUBLE_EQ(plan.advance_cdeg, 40.0);
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_EQ(points[0].intensity, 2.0F);
}

TEST(Decoder, AzimuthOutOfRangeIsABadBlock) {
  std::vector<int> azimuths = azimuth_steps(1000, 40);
  azimuths[5] = 36001;
  Decoder decoder({});
  const Payload payload = make_payload(azimuths, {{5, 0, {1, 1, 1}}}, {0, 0, 0, 0, 0x37, 0x22});
  EXPECT_TRUE(decode_all(decoder, payload).empty());
}

TEST(Decoder, AFullTurnIsAzimuthZero) {
  std::vector<int> azimuths = azimuth_steps(35880, 20);
  azimuths[6] = 36000;
  Decoder decoder({});
  const Payload payload =
      make_payload(azimuths, {{6, 0, {0x88, 0x13, 1}}}, {0, 0, 0, 0, 0x37, 0x22});
  const PacketPlan plan = decoder.plan(payload, decoder.tail(payload).mode);
  EXPECT_EQ(plan.bad_blocks, 0);
  EXPECT_DOUBLE_EQ(plan.advance_cdeg, 20.0);
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_NEAR(points[0].y, 0.0, 1e-6);
}

TEST(Decoder, OneLargeGapIsARestrictedViewAndTakesTime) {
  // A view of 90 degrees: after 7 blocks the sensor passes 270 degrees, about 1351 groups of 0.20
  // degrees.
  std::vector<int> azimuths;
  for (int k = 0; k < 12; ++k) azimuths.push_back(k < 7 ? 17860 + 20 * k : 9000 + 20 * (k - 7));
  Decoder decoder({});
  const Payload payload = make_payload(azimuths, {}, {0, 0, 0, 0, 0x37, 0x22});
  const PacketPlan plan = decoder.plan(payload, decoder.tail(payload).mode);
  EXPECT_EQ(plan.gap_before_group, 7);
  EXPECT_DOUBLE_EQ(plan.advance_cdeg, 20.0);
  const double passed_groups = (36000.0 - 17980.0 + 9000.0) / 20.0;
  const double step_ns = static_cast<double>(plan.group[7].offset_ns - plan.group[6].offset_ns);
  EXPECT_NEAR(step_ns, passed_groups * 110592.0, 1.0);
  EXPECT_NEAR(static_cast<double>(plan.duration_ns), (passed_groups + 11.0) * 110592.0, 1.0);
}

TEST(Decoder, AStoppedMotorDoesNotInterpolate) {
  Decoder decoder({});
  const Payload payload =
      make_payload(azimuth_steps(500, 0), {{0, 31, {0x88, 0x13, 1}}}, {0, 0, 0, 0, 0x37, 0x22});
  const PacketPlan plan = decoder.plan(payload, decoder.tail(payload).mode);
  EXPECT_EQ(plan.advance_cdeg, 0.0);
  const std::vector<Point> points = decode_all(decoder, payload);
  ASSERT_EQ(points.size(), 1U);
  EXPECT_NEAR(std::atan2(-points[0].y, points[0].x), 5.0 * M_PI / 180.0, 1e-6);
}

}  // namespace
}  // namespace zloam::driver::velodyne
