#include "driver/velodyne/model_check.hpp"

#include <gtest/gtest.h>

#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver {
namespace {

std::vector<std::vector<std::uint8_t>> first_packets(std::uint8_t product_id, double group_us) {
  test::TurningSensor sensor;
  sensor.product_id = product_id;
  sensor.group_us = group_us;
  std::vector<std::vector<std::uint8_t>> payloads;
  while (payloads.size() < kTimingPackets) {
    const test::Payload payload = sensor.next();
    payloads.emplace_back(payload.begin(), payload.end());
  }
  return payloads;
}

constexpr double kVlp16GroupUs = 110.592;
constexpr double kHdl32eGroupUs = 46.08;

TEST(ModelCheck, AVlp16WithTheProductByteOfAnHdl32eIsKnownByItsTiming) {
  EXPECT_EQ(model_by_timing(first_packets(0x21, kVlp16GroupUs), Model::kVlp16), Model::kVlp16);
}

TEST(ModelCheck, AnHdl32eStaysOneWhateverIsDeclared) {
  EXPECT_EQ(model_by_timing(first_packets(0x21, kHdl32eGroupUs), Model::kVlp16), std::nullopt);
}

TEST(ModelCheck, NothingIsSaidWithoutADeclarationOrWithTooFewPackets) {
  auto payloads = first_packets(0x21, kVlp16GroupUs);
  EXPECT_EQ(model_by_timing(payloads, std::nullopt), std::nullopt);
  payloads.pop_back();
  EXPECT_EQ(model_by_timing(payloads, Model::kVlp16), std::nullopt);
  EXPECT_EQ(model_by_timing({}, Model::kVlp16), std::nullopt);
}

TEST(ModelCheck, ALostPacketDoesNotMatter) {
  auto payloads = first_packets(0x21, kVlp16GroupUs);
  payloads.erase(payloads.begin() + 3);
  test::TurningSensor later;
  later.product_id = 0x21;
  later.time_us = 1'000'000.0 + 7 * 1327.104;
  const test::Payload last = later.next();
  payloads.emplace_back(last.begin(), last.end());
  EXPECT_EQ(model_by_timing(payloads, Model::kVlp16), Model::kVlp16);
}

}  // namespace
}  // namespace zloam::driver
