#include "driver/ouster/metadata.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "driver/ouster/test_sensor.hpp"

namespace zloam::driver::ouster {
namespace {

using test::Description;
using ::testing::HasSubstr;

std::string error_of(const std::string& text) {
  const auto parsed = parse_metadata(text);
  const auto* error = std::get_if<std::string>(&parsed);
  return error != nullptr ? *error : "no error";
}

TEST(OusterMetadata, NestedLayout) {
  const Metadata metadata = Description{}.metadata();
  EXPECT_EQ(metadata.model, "OS-1-16");
  EXPECT_EQ(metadata.serial, 122201000998U);
  EXPECT_EQ(metadata.initialization_id, 7109750U);
  EXPECT_EQ(metadata.columns_per_frame, 1024);
  EXPECT_DOUBLE_EQ(metadata.column_ns(), 97656.25);
  EXPECT_DOUBLE_EQ(metadata.beam_origin_x_m, 0.0158);
  EXPECT_DOUBLE_EQ(metadata.beam_origin_z_m, 0.0042);
  EXPECT_DOUBLE_EQ(metadata.T_sensor_lidar.translation().z(), 0.03618);
  EXPECT_DOUBLE_EQ(metadata.T_sensor_imu.translation().y(), -0.011775);
}

TEST(OusterMetadata, FlatLayoutOfOlderFirmware) {
  const std::string angles = test::list_of(std::vector<double>(16, 1.0));
  const auto parsed = parse_metadata(
      R"({"prod_line": "OS-1-16", "lidar_mode": "512x20", "lidar_origin_to_beam_origin_mm": 12.1,)"
      R"( "beam_altitude_angles": )" +
      angles + R"(, "beam_azimuth_angles": )" + angles +
      R"(, "data_format": {"pixels_per_column": 16, "columns_per_frame": 512,)"
      R"( "columns_per_packet": 16}})");
  const auto* metadata = std::get_if<Metadata>(&parsed);
  ASSERT_NE(metadata, nullptr) << std::get<std::string>(parsed);
  EXPECT_EQ(metadata->profile->name, kLegacy);
  EXPECT_DOUBLE_EQ(metadata->frames_per_s, 20.0);
  EXPECT_DOUBLE_EQ(metadata->beam_origin_x_m, 0.0121);
  EXPECT_EQ(metadata->last_column, 511);
}

// Manual, "Lidar Data Packet Size Calculation": header 32, 16 columns of 12 + pixels, footer 32;
// for LEGACY, 16 columns of 16 + pixels + 4.
TEST(OusterMetadata, PacketSizesOfTheManual) {
  const std::vector<std::tuple<std::string, int, std::size_t>> sizes = {
      {"LEGACY", 32, 6464},
      {"LEGACY", 64, 12608},
      {"LEGACY", 128, 24896},
      {"RNG19_RFL8_SIG16_NIR16", 32, 6400},
      {"RNG19_RFL8_SIG16_NIR16", 128, 24832},
      {"RNG19_RFL8_SIG16_NIR16_DUAL", 32, 8448},
      {"RNG19_RFL8_SIG16_NIR16_DUAL", 128, 33024},
      {"RNG15_RFL8_NIR8", 64, 4352},
      {"RNG15_RFL8_NIR8", 128, 8448},
      {"FUSA_RNG15_RFL8_NIR8_DUAL", 128, 16640}};
  for (const auto& [profile, pixels, bytes] : sizes) {
    SCOPED_TRACE(profile + " " + std::to_string(pixels));
    Description description;
    description.profile = profile;
    description.pixels = pixels;
    EXPECT_EQ(description.metadata().packet_bytes(), bytes);
  }
}

TEST(OusterMetadata, AWindowMayGoOverTheFramesEnd) {
  Description description;
  description.window = "[1000, 23]";
  const Metadata metadata = description.metadata();
  EXPECT_TRUE(metadata.sees(1000) && metadata.sees(1023) && metadata.sees(0) && metadata.sees(23));
  EXPECT_FALSE(metadata.sees(24) || metadata.sees(999));
}

TEST(OusterMetadata, WhatIsWrongIsNamed) {
  EXPECT_THAT(error_of(""), HasSubstr("no JSON object"));
  EXPECT_THAT(error_of("[1, 2"), HasSubstr("no JSON object"));
  EXPECT_THAT(error_of("{}"), HasSubstr("pixels_per_column"));
  Description description;
  description.profile = "RNG99";
  EXPECT_THAT(error_of(description.text()), HasSubstr("RNG99, which is not decoded; decoded are"));
  description = {};
  description.mode = "1024x0";
  EXPECT_THAT(error_of(description.text()), HasSubstr("lidar_mode"));
  description = {};
  description.window = "[0, 1024]";
  EXPECT_THAT(error_of(description.text()), HasSubstr("column_window"));
  description = {};
  description.pixels = 18;
  EXPECT_THAT(error_of(description.text()), HasSubstr("multiple of 4"));
  std::string text = Description{}.text();
  text.replace(text.find("[-1,0,0,0"), 9, "[-2,0,0,0");
  EXPECT_THAT(error_of(text), HasSubstr("lidar_to_sensor_transform does not turn"));
}

}  // namespace
}  // namespace zloam::driver::ouster
