// Compares returns with the surfaces that they come from, with the sensor at rest and moving.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <string>

#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"
#include "simulator/test_decoder.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;
using test::decode;
using test::Decoded;
using test::exact;
using test::kElevation;
using test::u32;

double distance_to(const World& world, int surface, const Vector3d& p) {
  if (surface == kGround) {
    return std::abs(p.z() - world.terrain()->height(p.x(), p.y()));
  }
  return distance_to_surface(p, world.shapes()[static_cast<std::size_t>(surface)]);
}

class DecodedWorld : public testing::TestWithParam<std::string> {};

TEST_P(DecodedWorld, PointsLieOnTheSurfacesAtTheirOwnInstant) {
  SimulationConfig config = exact();
  config.T_base_lidar = pose_from_xyz_rpy_deg({0.3, -0.1, 0.8}, {2.0, -5.0, 30.0});
  const auto scene = make_scene(GetParam(), {.seed = 2});
  const Sensor sensor(scene, config);
  std::size_t checked = 0;
  double worst_rounded = 0.0;
  double worst_exact = 0.0;
  for (std::int64_t i = 3000; i < 3000 + 1800; i += 6) {
    std::vector<Return> returns;
    const DataPacket packet = sensor.data_packet(i, &returns);
    const std::vector<Decoded> points = decode(packet.bytes);
    ASSERT_EQ(points.size(), returns.size());
    const double stamp_s =
        (u32(packet.bytes.data() + 1200) - (config.epoch_ns / 1000) % 3'600'000'000) * 1e-6;
    for (const Decoded& d : points) {
      const auto r = std::find_if(returns.begin(), returns.end(), [&](const Return& candidate) {
        return candidate.block == d.block && candidate.channel == d.channel;
      });
      ASSERT_NE(r, returns.end());
      const double t = stamp_s + d.after_us * 1e-6;
      ASSERT_NEAR(t, static_cast<double>(r->time_ns) * 1e-9, 1.001e-6);
      const bool foliage =
          r->surface >= 0 &&
          scene->world.shapes()[static_cast<std::size_t>(r->surface)].density_per_m > 0.0;
      const bool rough =
          r->surface >= 0 &&
          scene->world.shapes()[static_cast<std::size_t>(r->surface)].roughness_m > 0.0;
      if (foliage || rough) {
        continue;
      }
      ++checked;
      const double off = distance_to(scene->world, r->surface, sensor.T_truth_lidar(t) * d.point);
      // Azimuths are rounded to 0.01 degrees at both ends of the interpolation.
      worst_rounded = std::max(worst_rounded, off / (1.1e-3 + 1.8e-4 * d.range_m));
      const double turn = (r->azimuth_deg - d.azimuth_deg) * pi / 180.0;
      const Vector3d unrounded = Eigen::AngleAxisd(-turn, Vector3d::UnitZ()) * d.point;
      const double exact_off =
          distance_to(scene->world, r->surface,
                      sensor.T_truth_lidar(static_cast<double>(r->time_ns) * 1e-9) * unrounded);
      worst_exact = std::max(worst_exact, exact_off);
    }
  }
  EXPECT_GT(checked, 20000U);
  EXPECT_LT(worst_rounded, 1.0);
  EXPECT_LT(worst_exact, 1.1e-3) << "half a unit of range, and the table's offsets in 0.1 mm";
}

INSTANTIATE_TEST_SUITE_P(Worlds, DecodedWorld,
                         testing::Values("city", "indoor", "handheld", "tunnel_weak"),
                         [](const auto& param) { return param.param; });

// A wall moves towards a sensor at rest.
TEST(Sensor, WhatMovesIsMetWhereItIsWhenTheLaserFires) {
  constexpr double kSpeed = 60.0;
  Track track({{0.0, {40.0, 0.0, 0.0}, 0.0}, {0.5, {40.0 - 0.5 * kSpeed, 0.0, 0.0}, 0.0}}, false);
  SceneBuilder builder;
  builder.box({1.0, 0.0, -60.0, 60.0, 2.0, 300.0, 0.0});
  std::vector<Mover> movers;
  movers.push_back({builder.take(), track});
  const auto scene =
      std::make_shared<const Scene>(Scene{World({}, std::nullopt, std::move(movers)),
                                          Trajectory(std::vector<Knot>(100, Knot::Zero()), 0.02)});
  for (const double beam_mrad : {0.0, 3.0}) {
    SimulationConfig config = exact();
    config.sensor.divergence_mrad = beam_mrad;
    config.sensor.detection_reflectivity = 0.0;
    const Sensor sensor(scene, config);
    std::size_t count = 0;
    double worst = 0.0;
    for (std::int64_t i = 0; i < 300; ++i) {
      std::vector<Return> returns;
      sensor.data_packet(i, &returns);
      for (const Return& r : returns) {
        const double t = static_cast<double>(r.time_ns) * 1e-9;
        const double w = kElevation[r.laser] * pi / 180.0;
        const double cos_x = std::cos(w) * std::cos(r.azimuth_deg * pi / 180.0);
        if (cos_x < 0.7) {
          continue;  // a beam's footprint on a slanted wall is long
        }
        worst = std::max(worst, std::abs(r.range_m * cos_x - (40.0 - kSpeed * t)));
        ASSERT_EQ(r.surface, 0);
        ++count;
      }
    }
    EXPECT_GT(count, 20000U);
    EXPECT_LT(worst, beam_mrad > 0.0 ? 2e-3 : 1.01e-3) << "within a packet it comes 80 mm nearer";
  }
}

TEST(Sensor, MovingThingsHideAndUncoverWhatIsBehindThem) {
  const auto moving = make_scene("moving", {.seed = 2});
  const auto city = make_scene("city", {.seed = 2});
  const Sensor with(moving, exact());
  const Sensor without(city, exact());
  const int first_moving = static_cast<int>(city->world.shapes().size());
  std::size_t on_moving = 0;
  std::size_t all = 0;
  for (std::int64_t i = 10000; i < 14000; i += 37) {
    std::vector<Return> a;
    std::vector<Return> b;
    with.data_packet(i, &a);
    without.data_packet(i, &b);
    std::size_t k = 0;
    for (const Return& r : a) {
      ++all;
      if (r.surface >= first_moving) {
        ++on_moving;
        continue;
      }
      while (k < b.size() && b[k].time_ns < r.time_ns) {
        ++k;
      }
      ASSERT_LT(k, b.size());
      ASSERT_EQ(b[k].time_ns, r.time_ns);
      ASSERT_EQ(b[k].range_m, r.range_m) << "what is not hidden is as it was";
    }
  }
  EXPECT_GT(on_moving, all / 100);
  EXPECT_LT(on_moving, all / 3);
}

TEST(Sensor, RoughAndLeafyThingsLookTheSameInEveryTurn) {
  SceneBuilder builder;
  builder.ellipsoid({8.0, 0.0, 0.0}, {2.0, 2.0, 2.0}, 60.0).density_per_m = 1.0;
  builder.box({-8.0, 0.0, -3.0, 3.0, 1.0, 30.0, 0.0}).roughness_m = 0.05;
  const auto scene = std::make_shared<const Scene>(Scene{
      World(builder.take(), std::nullopt), Trajectory(std::vector<Knot>(100, Knot::Zero()), 0.02)});
  SimulationConfig config = exact();
  config.sensor.speed_deviation = 0.0;
  config.sensor.detection_reflectivity = 0.0;
  // Revolutions of exactly 75 packets, so that the shots of each have the same directions.
  config.sensor.rotation_rpm = 60e9 / (75.0 * vlp16::packet_ns(ReturnMode::kStrongest));
  const Sensor sensor(scene, config);
  std::map<int, int> by_surface;
  for (std::int64_t i = 0; i < 75; ++i) {
    std::vector<Return> first;
    std::vector<Return> second;
    sensor.data_packet(i, &first);
    sensor.data_packet(i + 75, &second);
    ASSERT_EQ(first.size(), second.size());
    for (std::size_t k = 0; k < first.size(); ++k) {
      ASSERT_NEAR(first[k].range_m, second[k].range_m, 0.0021);
      ++by_surface[first[k].surface];
    }
  }
  EXPECT_GT(by_surface[0], 500);
  EXPECT_GT(by_surface[1], 5000);
}

}  // namespace
}  // namespace zloam::simulator
