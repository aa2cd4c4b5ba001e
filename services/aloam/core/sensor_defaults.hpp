#pragma once
// What A-LOAM's launch files set for a sensor: one set for the HDL-64E on a car, one for the rest.

#include <string_view>

#include "aloam/core/scan_to_map.hpp"

namespace zloam::aloam {

struct SensorDefaults {
  double min_range_m = 0.3;
  Leaves leaves;
};

inline SensorDefaults defaults_of(std::string_view sensor_model) {
  if (sensor_model.starts_with("HDL-64E")) return {5.0, {0.4, 0.8}};
  return {};
}

}  // namespace zloam::aloam
