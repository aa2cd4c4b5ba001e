#include "driver/velodyne/model_check.hpp"

#include <gtest/gtest.h>

#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver::velodyne {
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

/// Packets with these stamps, by default of a VLS-128.
std::vector<std::vector<std::uint8_t>> at_stamps(const std::vector<double>& stamps_us,
                                                 std::uint8_t product_id = 0xA1) {
  std::vector<std::vector<std::uint8_t>> payloads;
  for (const double stamp_us : stamps_us) {
    const auto toh_us = static_cast<std::uint32_t>(stamp_us);
    const test::Payload payload = test::make_payload(
        test::azimuth_steps(0, 20), {},
        {static_cast<std::uint8_t>(toh_us), static_cast<std::uint8_t>(toh_us >> 8),
         static_cast<std::uint8_t>(toh_us >> 16), 0, 0x37, product_id});
    payloads.emplace_back(payload.begin(), payload.end());
  }
  return payloads;
}

std::vector<double> every(double period_us) {
  std::vector<double> stamps_us;
  for (int i = 0; i < 7; ++i) stamps_us.push_back(1000.0 + period_us * i);
  return stamps_us;
}

TEST(ModelCheck, TheFiringPeriodOfAVls128IsWhatItsStampsSay) {
  EXPECT_EQ(measured_group_ns(at_stamps(every(173.4)), {}), 57800.0);
  EXPECT_NEAR(measured_group_ns(at_stamps(every(160.0)), {}), 160000.0 / 3.0, 1e-6);
  EXPECT_NEAR(measured_group_ns(at_stamps(every(165.8)), {}), 165800.0 / 3.0, 100.0);
  std::vector<double> lossy = every(165.8);
  lossy.erase(lossy.begin() + 3);
  EXPECT_NEAR(measured_group_ns(at_stamps(lossy), {}), 165800.0 / 3.0, 150.0);
}

TEST(ModelCheck, OtherModelsHaveTheirOwnPeriod) {
  EXPECT_EQ(measured_group_ns(at_stamps(every(1000.0), 0x22), {}), 0.0);
  EXPECT_EQ(measured_group_ns({}, {}), 0.0);
  EXPECT_EQ(measured_group_ns(at_stamps({1000.0}), {}), 0.0);
}

}  // namespace
}  // namespace zloam::driver::velodyne
