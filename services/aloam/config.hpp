#pragma once
// What can be set about A-LOAM's stages: section aloam of the robot's file. What A-LOAM's launch
// files set for a sensor follows from sensor.model (core/sensor_defaults.hpp).

#include "common/runtime/parameters.hpp"

namespace zloam::aloam {

struct AloamConfig {
  /// move points to the sweep's middle by their measured times; as released a sweep is rigid
  bool deskew = false;
};

inline constexpr const char* kVariant = "aloam";

/// All three programs read the same section, so that one file or --set serves them all.
inline void bind(runtime::Parameters& p, AloamConfig& c) {
  p.add(
      "aloam.deskew", &c.deskew,
      "move each sweep's points to its middle by their measured times; A-LOAM as released takes a "
      "sweep as rigid");
}

}  // namespace zloam::aloam
