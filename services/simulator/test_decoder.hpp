#pragma once
// An independent decoder after the formulas of the manual, which shares no code with the encoder,
// and helpers shared by the tests of the sensor.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>
#include <vector>

#include "simulator/scene_builder.hpp"
#include "simulator/sensor.hpp"

namespace zloam::simulator::test {

struct Decoded {
  int block, channel, laser;
  double after_us;  // since the packet's stamp
  double azimuth_deg;
  double range_m;
  int reflectivity;
  Eigen::Vector3d point;
};

inline unsigned u16(const std::uint8_t* p) { return p[0] + 256U * p[1]; }
inline unsigned u32(const std::uint8_t* p) { return u16(p) + 65536U * u16(p + 2); }

inline constexpr double kElevation[16] = {-15, 1, -13, 3,  -11, 5,  -9, 7,
                                          -7,  9, -5,  11, -3,  13, -1, 15};

inline std::vector<Decoded> decode(const vlp16::DataBytes& bytes) {
  std::vector<Decoded> out;
  const bool dual = bytes[1204] == 0x39;
  const int pair = dual ? 2 : 1;
  double gap = 0.0;
  for (int k = 0; k < 12; ++k) {
    const std::uint8_t* block = bytes.data() + 100 * k;
    EXPECT_EQ(block[0], 0xFF);
    EXPECT_EQ(block[1], 0xEE);
    const unsigned azimuth = u16(block + 2);
    EXPECT_LT(azimuth, 36000U);
    if (k + pair < 12) {
      gap = (u16(block + 100 * pair + 2) + 36000U - azimuth) % 36000U / 100.0;
    }
    for (int c = 0; c < 32; ++c) {
      const std::uint8_t* entry = block + 4 + 3 * c;
      if (u16(entry) == 0) {
        continue;
      }
      Decoded d;
      d.block = k;
      d.channel = c;
      d.laser = c % 16;
      const double within = (c / 16) * 55.296 + (c % 16) * 2.304;
      d.after_us = (k / pair) * 110.592 + within;
      d.azimuth_deg = azimuth / 100.0 + gap * within / 110.592;
      d.range_m = u16(entry) * 0.002;
      d.reflectivity = entry[2];
      const double a = d.azimuth_deg * std::numbers::pi / 180.0;
      const double w = kElevation[d.laser] * std::numbers::pi / 180.0;
      d.point = {d.range_m * std::cos(w) * std::cos(a), -d.range_m * std::cos(w) * std::sin(a),
                 d.range_m * std::sin(w) + 0.04191 * std::tan(-w)};
      out.push_back(d);
    }
  }
  return out;
}

/// Without noise of any kind.
inline SimulationConfig exact() {
  SimulationConfig config;
  config.sensor.noise_sigma_m = 0.0;
  config.sensor.dropout = 0.0;
  config.sensor.reflectivity_sigma = 0.0;
  return config;
}

// A wall in front of a sensor that stands still.
inline std::shared_ptr<const Scene> still_scene(double wall_x) {
  SceneBuilder builder;
  builder.box({wall_x + 0.5, 0.0, -60.0, 60.0, 1.0, 400.0, 0.0, 50.0});
  std::vector<Knot> knots(500, Knot::Zero());
  return std::make_shared<const Scene>(
      Scene{World(builder.take(), std::nullopt), Trajectory(std::move(knots), 0.02)});
}

}  // namespace zloam::simulator::test
