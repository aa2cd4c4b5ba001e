// The points are bit-identical, whichever instruction set is used.
#include "driver/ouster/column_points.hpp"

#include <gtest/gtest.h>

#include <random>

#include "driver/ouster/test_sensor.hpp"

namespace zloam::driver::ouster {
namespace {

void expect_same_points(const test::Description& description, DualReturns policy,
                        std::mt19937& random) {
  const Metadata metadata = description.metadata();
  const ColumnReader reader(metadata, {.dual_returns = policy, .min_range_m = 1.0});
  const std::vector<ColumnPose> poses = column_poses(metadata);
  // Exactly as long as the pixels, so that a sanitizer detects reads beyond them.
  std::vector<test::Bytes> pixels(3, test::Bytes(4 * reader.words));
  std::vector<MeasuredColumn> columns;
  for (std::size_t c = 0; c < pixels.size(); ++c) {
    for (std::uint8_t& byte : pixels[c]) byte = static_cast<std::uint8_t>(random() % 4);
    columns.push_back({pixels[c].data(), &poses[100 * c], static_cast<std::uint32_t>(1000 * c),
                       static_cast<std::uint16_t>(c)});
  }
  const std::size_t room = columns.size() * reader.lanes + 1;
  std::vector<Point> points(room), portable(room);
  std::vector<std::uint16_t> numbers(room + 16), portable_numbers(room + 16);
  const std::size_t count = put_columns(columns, reader, points.data(), numbers.data());
  const std::size_t expected =
      put_columns_portable(columns, reader, portable.data(), portable_numbers.data());
  ASSERT_EQ(count, expected);
  ASSERT_GT(count, 0U);
  EXPECT_EQ(std::memcmp(points.data(), portable.data(), count * sizeof(Point)), 0);
  numbers.resize(count);
  portable_numbers.resize(count);
  EXPECT_EQ(numbers, portable_numbers);
}

TEST(OusterColumnPoints, AreTheSameWithAndWithoutWideRegisters) {
  std::mt19937 random(7);
  for (const char* profile :
       {"LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL",
        "RNG19_RFL8_SIG16_NIR16_RGB16", "RNG19_RFL8_SIG16_NIR16_RGB16_DUAL", "RNG15_RFL8_NIR8",
        "RNG15_RFL8_NIR8_ZONE16", "FUSA_RNG15_RFL8_NIR8_DUAL", "FIVE_WORD_PIXEL"}) {
    for (const int pixels : {16, 20, 32, 128}) {
      for (const char* order : {"STRONGEST_TO_WEAKEST", "FARTHEST_TO_NEAREST"}) {
        for (const DualReturns policy : {DualReturns::kStrongest, DualReturns::kLast,
                                         DualReturns::kBoth, DualReturns::kTagged}) {
          SCOPED_TRACE(std::string(profile) + " " + std::to_string(pixels) + " " + order);
          test::Description description;
          description.profile = profile;
          description.pixels = pixels;
          description.return_order = order;
          expect_same_points(description, policy, random);
        }
      }
    }
  }
}

}  // namespace
}  // namespace zloam::driver::ouster
