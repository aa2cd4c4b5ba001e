#include "simulator/sensor.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <map>
#include <numbers>
#include <string>

#include "simulator/io/parallel.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"

namespace zloam::simulator {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

// A decoder of its own, after the formulas of the manual; shares nothing with the encoder.
struct Decoded {
  int block, channel, laser;
  double after_us;  // since the packet's stamp
  double azimuth_deg;
  double range_m;
  int reflectivity;
  Vector3d point;
};

unsigned u16(const std::uint8_t* p) { return p[0] + 256U * p[1]; }
unsigned u32(const std::uint8_t* p) { return u16(p) + 65536U * u16(p + 2); }

const double kElevation[16] = {-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15};

std::vector<Decoded> decode(const vlp16::DataBytes& bytes) {
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
      const double a = d.azimuth_deg * pi / 180.0;
      const double w = kElevation[d.laser] * pi / 180.0;
      d.point = {d.range_m * std::cos(w) * std::cos(a), -d.range_m * std::cos(w) * std::sin(a),
                 d.range_m * std::sin(w) + 0.04191 * std::tan(-w)};
      out.push_back(d);
    }
  }
  return out;
}

SimulationConfig exact() {
  SimulationConfig config;
  config.sensor.noise_sigma_m = 0.0;
  config.sensor.dropout = 0.0;
  config.sensor.reflectivity_sigma = 0.0;
  return config;
}

double distance_to(const World& world, int surface, const Vector3d& p) {
  if (surface == kGround) {
    return std::abs(p.z() - world.terrain()->height(p.x(), p.y()));
  }
  return distance_to_surface(p, world.shapes()[static_cast<std::size_t>(surface)]);
}

// A level plane of ground under a sensor that stands still, and a wall.
std::shared_ptr<const Scene> still_scene(double wall_x) {
  SceneBuilder builder;
  builder.box({wall_x + 0.5, 0.0, -60.0, 60.0, 1.0, 400.0, 0.0, 50.0});
  std::vector<Knot> knots(500, Knot::Zero());
  return std::make_shared<const Scene>(
      Scene{World(builder.take(), std::nullopt), Trajectory(std::move(knots), 0.02)});
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

TEST(Sensor, TailSaysModeProductAndTimeOfTheHour) {
  SimulationConfig config = exact();
  config.epoch_ns = 1'704'070'799'999'000'000;  // 1 ms before 01:00
  const auto scene = still_scene(10.0);
  for (const ReturnMode mode : {ReturnMode::kStrongest, ReturnMode::kLast, ReturnMode::kDual}) {
    config.sensor.mode = mode;
    const Sensor sensor(scene, config);
    const DataPacket first = sensor.data_packet(0);
    const DataPacket fourth = sensor.data_packet(3);
    EXPECT_EQ(first.bytes[1204], static_cast<int>(mode));
    EXPECT_EQ(first.bytes[1205], 0x22);
    EXPECT_EQ(u32(first.bytes.data() + 1200), 3'599'999'000U);
    const double after_us = mode == ReturnMode::kDual ? 3 * 663.552 : 3 * 1327.104;
    EXPECT_EQ(u32(fourth.bytes.data() + 1200), static_cast<unsigned>(after_us) - 1000U);
  }
}

TEST(Sensor, AzimuthTurnsClockwiseAtTheRateAskedFor) {
  SimulationConfig config = exact();
  config.sensor.rotation_rpm = 1200.0;
  config.sensor.speed_deviation = 0.0;
  config.sensor.start_azimuth_deg = 90.0;
  SceneBuilder builder;
  builder.box({0.0, -5.5, -20.0, 20.0, 40.0, 1.0, 0.0});  // to the right: 90 degrees clockwise
  std::vector<Knot> knots(50, Knot::Zero());
  const auto scene = std::make_shared<const Scene>(
      Scene{World(builder.take(), std::nullopt), Trajectory(std::move(knots), 0.02)});
  const Sensor sensor(scene, config);
  const DataPacket packet = sensor.data_packet(0);
  EXPECT_EQ(u16(packet.bytes.data() + 2), 9000U);
  // 1200 turns a minute: 7200 degrees a second, 0.7963 degrees a block.
  EXPECT_EQ(u16(packet.bytes.data() + 1102), 9000U + 876U);
  const std::vector<Decoded> points = decode(packet.bytes);
  ASSERT_FALSE(points.empty());
  EXPECT_NEAR(points.front().point.y(), -5.0, 2e-3);
  EXPECT_NEAR(points.front().point.x(), 0.0, 2e-3);
}

TEST(Sensor, RotorTimeIsTheInverseOfItsAngle) {
  SimulationConfig config;
  config.sensor.speed_deviation = 0.02;
  const Sensor sensor(still_scene(10.0), config);
  for (double t = 0.0; t < 9.0; t += 0.37) {
    EXPECT_NEAR(sensor.rotor_time_s(sensor.rotor_deg(t)), t, 1e-12);
  }
}

TEST(Sensor, BytesDependOnSeedAndNotOnThreadsOrOrder) {
  const auto scene = make_scene("park", {.seed = 1});
  SimulationConfig config;
  const Sensor sensor(scene, config);
  const auto one = data_packets(sensor, 2000, 60, 1);
  const auto three = data_packets(sensor, 2000, 60, 3);
  config.seed = 2;
  const auto other = data_packets(Sensor(scene, config), 2000, 60, 1);
  ASSERT_EQ(one.size(), three.size());
  int equal_to_other = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    EXPECT_EQ(one[i].bytes, three[i].bytes);
    EXPECT_EQ(one[i].bytes, sensor.data_packet(2000 + static_cast<std::int64_t>(i)).bytes);
    equal_to_other += one[i].bytes == other[i].bytes ? 1 : 0;
  }
  EXPECT_EQ(equal_to_other, 0);
}

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
  // Reflectivity 50 against 49 at 100 m: the signal suffices while 50 / 49 cos >= (r / 100)^2, and
  // r = 60 / cos, so while cos^3 >= 0.98 * 0.36. All would be seen while r <= 100, cos >= 0.6.
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

// A pole in front of a wall: rays at its edge meet both.
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
    std::map<int, std::pair<double, double>> pairs;  // by firing: last, strongest
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
        // The odd block is never farther than the last return.
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

TEST(Sensor, PositionPacketTellsTimeAndPlace) {
  SimulationConfig config;
  config.epoch_ns = 1'704'070'799'999'000'000;  // 2024-01-01T00:59:59.999
  const Sensor sensor(still_scene(10.0), config);
  const vlp16::PositionBytes bytes = sensor.position_packet(13);  // 14 * 1327.104 us later
  EXPECT_EQ(u32(bytes.data() + 198), 18'579'456U / 1000U - 1000U);
  EXPECT_EQ(bytes[202], 2);
  const std::string sentence(reinterpret_cast<const char*>(bytes.data()) + 206);
  EXPECT_EQ(sentence.substr(0, 14), "$GPRMC,010000,");
  EXPECT_NE(sentence.find(",4800.0000,N,01100.0000,E,000.0,000.0,010124,"), std::string::npos);
  const std::size_t star = sentence.find('*');
  ASSERT_EQ(sentence.size(), star + 5);
  EXPECT_EQ(sentence.substr(star + 3), "\r\n");
  unsigned sum = 0;
  for (std::size_t i = 1; i < star; ++i) {
    sum ^= static_cast<unsigned char>(sentence[i]);
  }
  EXPECT_EQ(static_cast<unsigned>(std::stoi(sentence.substr(star + 1, 2), nullptr, 16)), sum);
  for (std::size_t i = 0; i < 198; ++i) {
    ASSERT_EQ(bytes[i], 0);
  }
}

TEST(Sensor, TruthTurnsAndShiftsWithoutChangingThePackets) {
  const auto scene = make_scene("indoor", {.seed = 1});
  SimulationConfig config;
  const Sensor plain(scene, config);
  config.T_truth_world = pose_from_xyz_rpy_deg({5.0, -3.0, 1.0}, {0.0, 0.0, 37.0});
  config.T_base_lidar = pose_from_xyz_rpy_deg({0.4, 0.2, 1.1}, {0.0, 0.0, 0.0});
  const Sensor turned_sensor(scene, config);
  EXPECT_EQ(plain.data_packet(1234).bytes, turned_sensor.data_packet(1234).bytes);
  const Pose a = config.T_truth_world * plain.T_truth_lidar(12.3);
  EXPECT_TRUE(a.isApprox(turned_sensor.T_truth_lidar(12.3), 1e-12));
  EXPECT_TRUE(turned_sensor.T_truth_lidar(12.3).isApprox(
      turned_sensor.T_truth_base(12.3) * config.T_base_lidar, 1e-12));
}

// A wall that comes towards a sensor at rest.
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
  // Turns of exactly 75 packets, so that each of their shots looks along the same line again.
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

TEST(Sensor, RefusesImpossibleSettings) {
  const auto scene = still_scene(10.0);
  const auto with = [&](auto change) {
    SimulationConfig config;
    change(config.sensor);
    return Sensor(scene, config);
  };
  EXPECT_THROW(with([](SensorConfig& s) { s.rotation_rpm = 200.0; }), std::invalid_argument);
  EXPECT_THROW(with([](SensorConfig& s) { s.dropout = 1.5; }), std::invalid_argument);
  EXPECT_THROW(with([](SensorConfig& s) { s.noise_sigma_m = -1.0; }), std::invalid_argument);
  EXPECT_THROW(with([](SensorConfig& s) { s.max_range_m = 200.0; }), std::invalid_argument);
  EXPECT_THROW(Sensor(nullptr, {}), std::invalid_argument);
  EXPECT_THROW(make_scene("nowhere", {}), std::invalid_argument);
}

}  // namespace
}  // namespace zloam::simulator
