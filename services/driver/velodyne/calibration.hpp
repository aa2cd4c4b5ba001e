#pragma once
// The calibration of one HDL-64E: each unit has its own (HDL-64E S3 User Manual 63-HDL64ES3, "Laser
// and Detector Calibration"). Reads two forms of the file: the maker's db.xml (degrees and
// centimetres), and the YAML that ROS drivers make of it (radians and metres).

#include <cstdint>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace zloam::driver::velodyne {

struct LaserCalibration {
  double elevation_rad = 0.0;
  /// the laser points to the block's azimuth minus this, clockwise
  double azimuth_correction_rad = 0.0;
  /// added to the distance of far points (25.04 m), and of near ones along the sensor's x (2.40 m)
  /// and y (1.93 m)
  double far_m = 0.0;
  double near_x_m = 0.0;
  double near_y_m = 0.0;
  double vertical_offset_m = 0.0;
  double horizontal_offset_m = 0.0;
  double focal_distance_m = 0.0;
  double focal_slope = 0.0;
  double least_intensity = 0.0;
  double greatest_intensity = 255.0;
  bool enabled = true;
};

struct Calibration {
  double distance_unit_m = 0.002;
  /// by the laser's number: 32 of the upper block, 32 of the lower one
  std::vector<LaserCalibration> lasers;
};

inline constexpr int kCalibratedLasers = 64;

/// XML, or YAML with a list of lasers.
bool looks_like_calibration(std::string_view text);

/// The text says what is wrong with the file.
std::variant<Calibration, std::string> parse_calibration(std::string_view text);

}  // namespace zloam::driver::velodyne
