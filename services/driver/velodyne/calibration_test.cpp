// Calibration files of an HDL-64E, valid and invalid.
#include "driver/velodyne/calibration.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "driver/velodyne/test_calibration.hpp"

namespace zloam::driver::velodyne {
namespace {

using ::testing::HasSubstr;

Calibration read(const std::string& text) {
  auto parsed = parse_calibration(text);
  if (const auto* error = std::get_if<std::string>(&parsed)) {
    ADD_FAILURE() << *error;
    return {.lasers = std::vector<LaserCalibration>(kCalibratedLasers)};
  }
  return std::get<Calibration>(std::move(parsed));
}

std::string error_of(const std::string& text) {
  const auto parsed = parse_calibration(text);
  const auto* error = std::get_if<std::string>(&parsed);
  return error ? *error : std::string();
}

std::string with(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, text.npos);
  return text.replace(at, from.size(), to);
}

TEST(Calibration, BothFormsSayTheSame) {
  const Calibration yaml = read(test::calibration_yaml());
  const Calibration xml = read(test::calibration_xml());
  ASSERT_EQ(yaml.lasers.size(), 64U);
  EXPECT_NEAR(xml.distance_unit_m, yaml.distance_unit_m, 1e-12);
  for (std::size_t i = 0; i < 64; ++i) {
    const LaserCalibration& a = yaml.lasers[i];
    const LaserCalibration& b = xml.lasers[i];
    EXPECT_NEAR(a.elevation_rad, b.elevation_rad, 2e-6);
    EXPECT_NEAR(a.azimuth_correction_rad, b.azimuth_correction_rad, 2e-6);
    EXPECT_NEAR(a.far_m, b.far_m, 1e-6);
    EXPECT_NEAR(a.near_x_m, b.near_x_m, 1e-6);
    EXPECT_NEAR(a.near_y_m, b.near_y_m, 1e-6);
    EXPECT_NEAR(a.vertical_offset_m, b.vertical_offset_m, 1e-6);
    EXPECT_NEAR(a.horizontal_offset_m, b.horizontal_offset_m, 1e-6);
    EXPECT_NEAR(a.focal_distance_m, b.focal_distance_m, 1e-6);
    EXPECT_EQ(a.focal_slope, b.focal_slope);
    EXPECT_EQ(a.least_intensity, 5.0);
    EXPECT_EQ(b.greatest_intensity, 255.0);
    EXPECT_EQ(b.enabled, i != 7);
  }
}

TEST(Calibration, WithoutNearPointsTheFarOneHoldsEverywhere) {
  const Calibration calibration =
      read(with(test::calibration_yaml(), "two_pt_correction_available: true",
                "two_pt_correction_available: false"));
  EXPECT_EQ(calibration.lasers[0].near_x_m, calibration.lasers[0].far_m);
  EXPECT_NE(calibration.lasers[1].near_x_m, calibration.lasers[1].far_m);
}

TEST(Calibration, WhatIsWrongIsNamed) {
  const std::string yaml = test::calibration_yaml();
  const std::string xml = test::calibration_xml();
  EXPECT_THAT(error_of(test::calibration_yaml(63)), HasSubstr("laser 63 is missing"));
  EXPECT_THAT(error_of(test::calibration_xml(60)), HasSubstr("laser 60 is missing"));
  EXPECT_THAT(error_of(with(yaml, "laser_id: 5,", "laser_id: 6,")),
              HasSubstr("laser 6 comes twice"));
  EXPECT_THAT(error_of(with(yaml, "laser_id: 5,", "laser_id: 64,")), HasSubstr("number 64"));
  EXPECT_THAT(error_of(with(yaml, "dist_correction: 1.4", "dist_corr: 1.4")),
              HasSubstr("laser 0: dist_correction is missing"));
  EXPECT_THAT(error_of(with(yaml, "dist_correction: 1.413949", "dist_correction: 141.3949")),
              HasSubstr("the distance correction (m) is 141"));
  EXPECT_THAT(error_of(with(yaml, "dist_correction: 1.413949", "dist_correction: .nan")),
              HasSubstr("which no unit has"));
  EXPECT_THAT(error_of(with(xml, "<vertCorrection_>", "<other_>")), HasSubstr("it is no XML"));
  EXPECT_THAT(error_of(with(xml, "<distLSB_>0.2<", "<distLSB_>0<")), HasSubstr("distance unit"));
  EXPECT_THAT(error_of("<a/>"), HasSubstr("boost_serialization/DB is missing"));
  EXPECT_THAT(error_of("lasers: 3"), HasSubstr("no list of lasers"));
}

TEST(Calibration, OtherDescriptionsAreNotTakenForOne) {
  EXPECT_TRUE(looks_like_calibration(test::calibration_yaml()));
  EXPECT_TRUE(looks_like_calibration(test::calibration_xml()));
  EXPECT_FALSE(looks_like_calibration("{\"sensor_info\": {}}"));
  EXPECT_FALSE(looks_like_calibration("Laser id,Elevation,Azimuth\n1,2,3\n"));
  EXPECT_FALSE(looks_like_calibration(""));
}

}  // namespace
}  // namespace zloam::driver::velodyne
