#include "simulator/sensor.hpp"

#include <gtest/gtest.h>

#include <stdexcept>
#include <string>

#include "simulator/io/parallel.hpp"
#include "simulator/scene_builder.hpp"
#include "simulator/scenes.hpp"
#include "simulator/test_decoder.hpp"

namespace zloam::simulator {
namespace {

using test::decode;
using test::Decoded;
using test::exact;
using test::still_scene;
using test::u16;
using test::u32;

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
  // 1200 revolutions per minute: 7200 degrees per second, 0.7963 degrees per block.
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
