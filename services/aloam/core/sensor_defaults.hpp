#pragma once
// What A-LOAM's launch files, and its code, set for a sensor: one set for the HDL-64E on a car, one
// for the rest.

#include <string_view>

#include "aloam/core/scan_registration.hpp"
#include "aloam/core/scan_to_map.hpp"

namespace zloam::aloam {

struct SensorDefaults {
  double min_range_m = 0.3;
  Leaves leaves;
  Elevations elevations;
};

inline SensorDefaults defaults_of(std::string_view sensor_model) {
  // A-LOAM's ring 32 + int(2 (-8.83 - elevation) + 0.5) is dropped if it is above 50.
  if (sensor_model.starts_with("HDL-64E")) return {5.0, {0.4, 0.8}, {-8.83 - 9.25, 2.0}};
  return {};
}

}  // namespace zloam::aloam
