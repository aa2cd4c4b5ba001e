#include "driver/velodyne/calibration.hpp"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <cstddef>
#include <numbers>
#include <pugixml.hpp>
#include <stdexcept>

namespace zloam::driver::velodyne {
namespace {

constexpr double kRadPerDeg = std::numbers::pi / 180.0;
constexpr double kMetresPerCm = 0.01;

/// Thrown by the readers of this file.
struct Wrong : std::runtime_error {
  using std::runtime_error::runtime_error;
};

std::string of_laser(int id, const char* name) {
  return "laser " + std::to_string(id) + ": " + name;
}

/// Stores each laser at its number, and checks that each number occurs exactly once.
class Lasers {
 public:
  LaserCalibration& add(int id) {
    if (id < 0 || id >= kCalibratedLasers) {
      throw Wrong("a laser has the number " + std::to_string(id) + "; 0 to 63 are expected");
    }
    const auto at = static_cast<std::size_t>(id);
    if (seen_[at]) throw Wrong("laser " + std::to_string(id) + " comes twice");
    seen_[at] = true;
    return lasers_[at];
  }
  std::vector<LaserCalibration> all() {
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      if (!seen_[i]) throw Wrong("laser " + std::to_string(i) + " is missing");
    }
    return std::move(lasers_);
  }

 private:
  std::vector<LaserCalibration> lasers_{kCalibratedLasers};
  std::vector<bool> seen_ = std::vector<bool>(kCalibratedLasers);
};

// No unit has greater corrections; greater values are in other units of measure.
void check(const LaserCalibration& laser, int id) {
  const auto within = [&](double value, double most, const char* name) {
    // Written so that NaN fails the condition.
    if (!(std::abs(value) <= most)) {
      throw Wrong(of_laser(id, name) + " is " + std::to_string(value) + ", which no unit has");
    }
  };
  within(laser.elevation_rad, 0.6, "the vertical correction (rad)");
  within(laser.azimuth_correction_rad, 0.6, "the rotational correction (rad)");
  within(laser.far_m, 10.0, "the distance correction (m)");
  within(laser.near_x_m, 10.0, "the near distance correction of x (m)");
  within(laser.near_y_m, 10.0, "the near distance correction of y (m)");
  within(laser.vertical_offset_m, 1.0, "the vertical offset (m)");
  within(laser.horizontal_offset_m, 1.0, "the horizontal offset (m)");
  within(laser.focal_distance_m, 1000.0, "the focal distance (m)");
  within(laser.focal_slope, 1000.0, "the focal slope");
}

double number_of(const pugi::xml_node& px, const char* name, int id) {
  const pugi::xml_node node = px.child(name);
  if (!node) throw Wrong(of_laser(id, name) + " is missing");
  const double value = node.text().as_double(std::nan(""));
  if (!std::isfinite(value)) throw Wrong(of_laser(id, name) + " is no number");
  return value;
}

LaserCalibration laser_of_xml(const pugi::xml_node& px, int id) {
  const auto degrees = [&](const char* name) { return kRadPerDeg * number_of(px, name, id); };
  const auto metres = [&](const char* name) { return kMetresPerCm * number_of(px, name, id); };
  LaserCalibration laser;
  laser.azimuth_correction_rad = degrees("rotCorrection_");
  laser.elevation_rad = degrees("vertCorrection_");
  laser.far_m = metres("distCorrection_");
  // Units before the second edition have a single correction for all distances.
  laser.near_x_m = px.child("distCorrectionX_") ? metres("distCorrectionX_") : laser.far_m;
  laser.near_y_m = px.child("distCorrectionY_") ? metres("distCorrectionY_") : laser.far_m;
  laser.vertical_offset_m = metres("vertOffsetCorrection_");
  laser.horizontal_offset_m = metres("horizOffsetCorrection_");
  if (px.child("focalDistance_")) laser.focal_distance_m = metres("focalDistance_");
  if (px.child("focalSlope_")) laser.focal_slope = number_of(px, "focalSlope_", id);
  return laser;
}

/// Value of laser n in a list of all lasers; the given default if there is none.
double item_of(const pugi::xml_node& list, int n, double otherwise) {
  for (const pugi::xml_node& item : list.children("item")) {
    if (n-- == 0) return std::floor(item.text().as_double(otherwise));
  }
  return otherwise;
}

Calibration parse_xml(std::string_view text) {
  pugi::xml_document document;
  const pugi::xml_parse_result result = document.load_buffer(text.data(), text.size());
  if (!result) {
    throw Wrong("it is no XML: " + std::string(result.description()) + " at byte " +
                std::to_string(result.offset));
  }
  const pugi::xml_node db = document.child("boost_serialization").child("DB");
  if (!db) throw Wrong("boost_serialization/DB is missing");
  Calibration calibration;
  if (db.child("distLSB_")) {
    calibration.distance_unit_m = kMetresPerCm * db.child("distLSB_").text().as_double();
  }
  Lasers lasers;
  for (const pugi::xml_node& item : db.child("points_").children("item")) {
    const pugi::xml_node px = item.child("px");
    const int id = px.child("id_").text().as_int(-1);
    LaserCalibration& laser = lasers.add(id);
    laser = laser_of_xml(px, id);
    laser.least_intensity = item_of(db.child("minIntensity_"), id, 0.0);
    laser.greatest_intensity = item_of(db.child("maxIntensity_"), id, 255.0);
    laser.enabled = item_of(db.child("enabled_"), id, 1.0) != 0.0;
    check(laser, id);
  }
  calibration.lasers = lasers.all();
  return calibration;
}

double number_of(const YAML::Node& laser, const char* name, int id) {
  if (!laser[name]) throw Wrong(of_laser(id, name) + " is missing");
  return laser[name].as<double>();
}

LaserCalibration laser_of_yaml(const YAML::Node& node, int id) {
  const auto number = [&](const char* name) { return number_of(node, name, id); };
  LaserCalibration laser;
  laser.azimuth_correction_rad = number("rot_correction");
  laser.elevation_rad = number("vert_correction");
  laser.far_m = number("dist_correction");
  const bool two_points =
      !node["two_pt_correction_available"] || node["two_pt_correction_available"].as<bool>();
  laser.near_x_m =
      two_points && node["dist_correction_x"] ? number("dist_correction_x") : laser.far_m;
  laser.near_y_m =
      two_points && node["dist_correction_y"] ? number("dist_correction_y") : laser.far_m;
  laser.vertical_offset_m = number("vert_offset_correction");
  laser.horizontal_offset_m =
      node["horiz_offset_correction"] ? number("horiz_offset_correction") : 0.0;
  laser.focal_distance_m = node["focal_distance"] ? number("focal_distance") : 0.0;
  laser.focal_slope = node["focal_slope"] ? number("focal_slope") : 0.0;
  if (node["min_intensity"]) laser.least_intensity = std::floor(number("min_intensity"));
  if (node["max_intensity"]) laser.greatest_intensity = std::floor(number("max_intensity"));
  return laser;
}

Calibration parse_yaml(std::string_view text) {
  const YAML::Node root = YAML::Load(std::string(text));
  if (!root.IsMap() || !root["lasers"] || !root["lasers"].IsSequence()) {
    throw Wrong("it has no list of lasers");
  }
  Calibration calibration;
  if (root["distance_resolution"]) {
    calibration.distance_unit_m = root["distance_resolution"].as<double>();
  }
  Lasers lasers;
  for (const YAML::Node& node : root["lasers"]) {
    if (!node.IsMap() || !node["laser_id"]) throw Wrong("a laser has no laser_id");
    const int id = node["laser_id"].as<int>();
    LaserCalibration& laser = lasers.add(id);
    laser = laser_of_yaml(node, id);
    check(laser, id);
  }
  calibration.lasers = lasers.all();
  return calibration;
}

bool is_xml(std::string_view text) {
  const std::size_t first = text.find_first_not_of(" \t\r\n");
  return first != text.npos && text[first] == '<';
}

}  // namespace

bool looks_like_calibration(std::string_view text) {
  return is_xml(text) || text.find("\nlasers:") != text.npos || text.starts_with("lasers:");
}

std::variant<Calibration, std::string> parse_calibration(std::string_view text) {
  try {
    Calibration calibration = is_xml(text) ? parse_xml(text) : parse_yaml(text);
    if (!(calibration.distance_unit_m > 1e-4 && calibration.distance_unit_m < 0.1)) {
      return "the distance unit is " + std::to_string(calibration.distance_unit_m) +
             " m, which no unit has";
    }
    return calibration;
  } catch (const Wrong& error) {
    return error.what();
  } catch (const YAML::Exception& error) {
    return error.what();
  }
}

}  // namespace zloam::driver::velodyne
