// Tests which returns a shot gives, and the effect of noise and limits on them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "simulator/scene_builder.hpp"
#include "simulator/test_decoder.hpp"

namespace zloam::simulator {
namespace {

using std::numbers::pi;
using test::decode;
using test::Decoded;
using test::exact;
using test::kElevation;
using test::still_scene;
using test::u16;

TEST(Sensor, NoiseAndDropoutsHaveTheStatisticsAskedFor) {
  const auto scene = still_scene(10.0);
  SimulationConfig config;
  config.sensor.speed_deviation = 0.0;
  config.sensor.noise_sigma_m = 0.03;
  config.sensor.dropout = 0.05;
  const Sensor noisy(scene, config);
  SimulationConfig clean_config = exact();
  clean_config.sensor.speed_deviation = 0.0;
  const Sensor clean(scene, clean_config);
  double sum = 0.0;
  double squares = 0.0;
  double worst = 0.0;
  double count = 0.0;
  double possible = 0.0;
  for (std::int64_t i = 0; i < 300; ++i) {
    std::vector<Return> with;
    std::vector<Return> without;
    noisy.data_packet(i, &with);
    clean.data_packet(i, &without);
    possible += static_cast<double>(without.size());
    std::size_t k = 0;
    for (const Return& r : with) {
      while (k < without.size() && without[k].time_ns != r.time_ns) {
        ++k;
      }
      ASSERT_LT(k, without.size());
      const double error = r.range_m - without[k].range_m;
      sum += error;
      squares += error * error;
      worst = std::max(worst, std::abs(error));
      count += 1.0;
    }
  }
  ASSERT_GT(count, 20000.0);
  EXPECT_NEAR(sum / count, 0.0, 4.0 * 0.03 / std::sqrt(count) + 1e-4);
  EXPECT_NEAR(std::sqrt(squares / count), 0.03, 0.0005);
  EXPECT_LE(worst, 4.0 * 0.03 + 0.0021);
  EXPECT_GT(worst, 3.0 * 0.03);
  EXPECT_NEAR(count / possible, 0.95, 0.005);
}

TEST(Sensor, RangeLimitsHold) {
  SimulationConfig config = exact();
  config.sensor.detection_reflectivity = 0.0;
  config.sensor.min_range_m = 9.0;
  config.sensor.max_range_m = 30.0;
  const Sensor sensor(still_scene(8.5), config);
  double nearest = 1e9;
  double farthest = 0.0;
  for (std::int64_t i = 0; i < 80; ++i) {
    for (const Decoded& d : decode(sensor.data_packet(i).bytes)) {
      nearest = std::min(nearest, d.range_m);
      farthest = std::max(farthest, d.range_m);
    }
  }
  EXPECT_GE(nearest, 9.0);
  EXPECT_LT(nearest, 9.1);
  EXPECT_LE(farthest, 30.0);
  EXPECT_GT(farthest, 29.0);
}

TEST(Sensor, DarkAndSlantedSurfacesAreLostFirst) {
  SimulationConfig config = exact();
  const auto returns_of = [&](double wall_x) {
    const Sensor sensor(still_scene(wall_x), config);
    std::size_t n = 0;
    for (std::int64_t i = 0; i < 76; ++i) {
      n += decode(sensor.data_packet(i).bytes).size();
    }
    return n;
  };
  // Reflectivity 50, detection limit 49 at 100 m: a return is detected while
  // 50 / 49 cos >= (r / 100)^2 with r = 60 / cos, that is while cos^3 >= 0.98 * 0.36. Without the
  // limit all returns with r <= 100, cos >= 0.6 are detected.
  config.sensor.detection_reflectivity = 49.0;
  const std::size_t some = returns_of(60.0);
  config.sensor.detection_reflectivity = 0.0;
  const std::size_t all = returns_of(60.0);
  double seen = 0.0;
  double within = 0.0;
  for (const double elevation : kElevation) {  // cos of the incidence = cos elevation * cos azimuth
    const double c = std::cos(elevation * pi / 180.0);
    seen += std::acos(std::cbrt(0.98 * 0.36) / c);
    within += std::acos(0.6 / c);
  }
  EXPECT_NEAR(static_cast<double>(some) / static_cast<double>(all), seen / within, 0.01);
}

// Poles in front of a wall: rays at a pole's edge hit both.
std::shared_ptr<const Scene> pole_scene() {
  SceneBuilder builder;
  builder.box({20.5, 0.0, -20.0, 20.0, 1.0, 100.0, 0.0, 40.0});
  for (int i = -20; i <= 20; ++i) {
    builder.cylinder(10.0, 0.3 * i, 0.02, -20.0, 20.0, 40.0);
  }
  std::vector<Knot> knots(50, Knot::Zero());
  return std::make_shared<const Scene>(
      Scene{World(builder.take(), std::nullopt), Trajectory(std::move(knots), 0.02)});
}

TEST(Sensor, DualModeFollowsTheRulesOfTheManual) {
  SimulationConfig config = exact();
  config.sensor.mode = ReturnMode::kDual;
  config.sensor.divergence_mrad = 3.0;
  const Sensor sensor(pole_scene(), config);
  int equal = 0;
  int two = 0;
  int second = 0;
  for (std::int64_t i = 0; i < 155; ++i) {
    const DataPacket packet = sensor.data_packet(i);
    std::map<int, std::pair<double, double>> pairs;  // per firing: last, strongest
    for (int k = 0; k < 12; k += 2) {
      EXPECT_EQ(u16(packet.bytes.data() + 100 * k + 2), u16(packet.bytes.data() + 100 * k + 102));
    }
    for (const Decoded& d : decode(packet.bytes)) {
      auto& pair = pairs[d.block / 2 * 32 + d.channel];
      (d.block % 2 == 0 ? pair.first : pair.second) = d.range_m;
    }
    for (const auto& [firing, pair] : pairs) {
      ASSERT_GT(pair.first, 0.0);
      ASSERT_GT(pair.second, 0.0);
      if (pair.first == pair.second) {
        ++equal;
      } else {
        ++two;
        ASSERT_GE(std::abs(pair.first - pair.second), 1.0);
        // The odd block's return is never farther than the last return.
        ASSERT_LT(pair.second, pair.first);
        second += pair.second < 15.0 ? 1 : 0;
      }
    }
  }
  EXPECT_GT(equal, 1000);
  EXPECT_GT(two, 200);
  EXPECT_EQ(second, two);
}

TEST(Sensor, SingleModesChooseTheReturnTheyAreNamedAfter) {
  SimulationConfig config = exact();
  config.sensor.divergence_mrad = 3.0;
  const auto scene = pole_scene();
  const Sensor strongest(scene, config);
  config.sensor.mode = ReturnMode::kLast;
  const Sensor last(scene, config);
  int differ = 0;
  for (std::int64_t i = 0; i < 76; ++i) {
    const auto a = decode(strongest.data_packet(i).bytes);
    const auto b = decode(last.data_packet(i).bytes);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t k = 0; k < a.size(); ++k) {
      ASSERT_LE(a[k].range_m, b[k].range_m);
      differ += a[k].range_m < b[k].range_m ? 1 : 0;
    }
  }
  EXPECT_GT(differ, 50);
}

TEST(Sensor, LaserBiasIsConstantForEachLaser) {
  SimulationConfig config = exact();
  config.sensor.range_bias_sigma_m = 0.02;
  const auto scene = still_scene(10.0);
  const Sensor biased(scene, config);
  const Sensor plain(scene, exact());
  std::map<int, double> bias;
  for (std::int64_t i = 0; i < 10; ++i) {
    const auto a = decode(biased.data_packet(i).bytes);
    const auto b = decode(plain.data_packet(i).bytes);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t k = 0; k < a.size(); ++k) {
      const double error = a[k].range_m - b[k].range_m;
      const auto [entry, fresh] = bias.try_emplace(a[k].laser, error);
      ASSERT_NEAR(entry->second, error, 0.0041);
    }
  }
  ASSERT_EQ(bias.size(), 16U);
  EXPECT_GT(std::abs(bias[0] - bias[5]) + std::abs(bias[1] - bias[9]), 0.004);
}

}  // namespace
}  // namespace zloam::simulator
