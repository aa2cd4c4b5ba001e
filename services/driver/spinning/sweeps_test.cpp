// Lines and angles to points, against worked examples; interpolation of the encoder's readings.

#include "driver/spinning/sweeps.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "driver/spinning/mount_file.hpp"

namespace zloam::driver::spinning {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr std::int64_t kMs = 1'000'000;
// Arbitrary origin of all stamps.
constexpr std::int64_t kZero = 1'700'000'000'000 * kMs;

scip::Parameters utm() {
  scip::Parameters p;
  p.model = "UTM-30LX";
  p.least_mm = 23;
  p.most_mm = 60000;
  p.steps_per_turn = 1440;
  p.last_step = 1080;
  p.front_step = 540;
  p.turns_per_minute = 2400;
  return p;
}

scip::TimedScan line_of(std::int64_t step0_ns, const std::vector<scip::Echo>& echoes) {
  scip::TimedScan timed;
  timed.stamp_ns = kZero + step0_ns;
  timed.scan.request.first_step = echoes.front().step;
  timed.scan.request.last_step = echoes.back().step;
  timed.scan.request.continuous = true;
  timed.scan.echoes = echoes;
  return timed;
}

Point only_point(const SpinningConfig& config, const scip::TimedScan& line,
                 const std::vector<AngleReading>& readings) {
  SpinningSweeps sweeps(config);
  for (const AngleReading& reading : readings) sweeps.add(reading);
  sweeps.add(line, utm());
  sweeps.flush();
  DecodedSweep sweep;
  EXPECT_TRUE(sweeps.take(sweep));
  EXPECT_EQ(sweep.points.size(), 1U);
  return sweep.points.empty() ? Point{} : sweep.points.front();
}

void expect_at(const Point& p, double x, double y, double z) {
  EXPECT_NEAR(p.x, x, 1e-5);
  EXPECT_NEAR(p.y, y, 1e-5);
  EXPECT_NEAR(p.z, z, 1e-5);
}

const std::vector<AngleReading> kSteady = {{kZero, 10.0 * kDegree},
                                           {kZero + 10 * kMs, 11.8 * kDegree},
                                           {kZero + 20 * kMs, 13.6 * kDegree},
                                           {kZero + 30 * kMs, 15.4 * kDegree}};

TEST(SpinningSweepsTest, WorkedExamples) {
  SpinningConfig config;
  expect_at(only_point(config, line_of(5 * kMs, {{900, 0, 4000, 0}}), kSteady), 0.0, 3.885990,
            0.948200);
  expect_at(only_point(config, line_of(5 * kMs, {{180, 0, 10000, 0}}), kSteady), 0.0, -9.800550,
            -1.987265);
  config.mount.T_motor_scanner.translation() = Eigen::Vector3d(0.03, 0.0, 0.05);
  expect_at(only_point(config, line_of(5 * kMs, {{900, 0, 4000, 0}}), kSteady), 0.030000, 3.874137,
            0.996775);
  expect_at(only_point(config, line_of(5 * kMs, {{540, 0, 4000, 0}}), kSteady), 4.030000, -0.010897,
            0.048798);
  const std::vector<AngleReading> through = {{kZero, -0.9 * kDegree},
                                             {kZero + 20 * kMs, 2.7 * kDegree}};
  expect_at(only_point({}, line_of(0, {{720, 0, 2500, 0}}), through), 1.767767, 1.767276, 0.041648);
}

TEST(SpinningSweepsTest, ZeroDirectionAndDelayOfTheEncoder) {
  // The readings of kSteady from an encoder that counts backward from another zero and stamps late.
  SpinningConfig config;
  config.mount.zero_rad = 40.0 * kDegree;
  config.mount.direction = -1.0;
  config.mount.angle_delay_ns = 3 * kMs;
  std::vector<AngleReading> readings = kSteady;
  for (AngleReading& r : readings) {
    r.stamp_ns += 3 * kMs;
    r.angle_rad = 40.0 * kDegree - r.angle_rad;
  }
  expect_at(only_point(config, line_of(5 * kMs, {{900, 0, 4000, 0}}), readings), 0.0, 3.885990,
            0.948200);
}

TEST(SpinningSweepsTest, CodesAndFarRangesAreNoPoints) {
  SpinningSweeps sweeps(SpinningConfig{});
  for (const AngleReading& reading : kSteady) sweeps.add(reading);
  sweeps.add(line_of(5 * kMs, {{540, 0, 0, 0},
                               {541, 0, 1, 0},
                               {542, 0, 5, 0},
                               {543, 0, 22, 0},
                               {544, 0, 23, 0},
                               {545, 0, 60001, 0},
                               {546, 0, 262143, 0}}),
             utm());
  sweeps.flush();
  DecodedSweep sweep;
  ASSERT_TRUE(sweeps.take(sweep));
  EXPECT_EQ(sweep.points.size(), 1U);
}

/// Lines every 25 ms, and every 2 ms a reading of a motor at 180 degrees per second.
struct Rig {
  SpinningSweeps sweeps{SpinningConfig{}};
  std::int64_t read_ns = 0;
  void read_until(std::int64_t until_ns) {
    for (; read_ns <= until_ns; read_ns += 2 * kMs) {
      const double angle_rad = 180.0 * kDegree * 1e-9 * static_cast<double>(read_ns);
      sweeps.add(AngleReading{kZero + read_ns, angle_rad});
    }
  }
  void line(std::int64_t number, std::int64_t turns = 1) {
    scip::TimedScan timed = line_of(25 * kMs * number, {{180, 0, 2000, 0}, {900, 0, 2000, 0}});
    timed.turns = turns;
    sweeps.add(std::move(timed), utm());
  }
  std::vector<DecodedSweep> taken() {
    std::vector<DecodedSweep> all;
    DecodedSweep sweep;
    while (sweeps.take(sweep)) all.push_back(std::move(sweep));
    return all;
  }
  std::uint64_t count(std::string_view name) const {
    for (const auto& [key, value] : sweeps.counts()) {
      if (key == name) return value;
    }
    return ~0ULL;
  }
};

TEST(SpinningSweepsTest, FourLinesAreASweepAndTenOfThemATurn) {
  Rig rig;
  rig.read_until(1100 * kMs);
  for (int i = 0; i < 40; ++i) rig.line(i);
  const auto sweeps = rig.taken();
  ASSERT_EQ(sweeps.size(), 10U);
  for (std::size_t i = 0; i < sweeps.size(); ++i) {
    const DecodedSweep& sweep = sweeps[i];
    EXPECT_TRUE(sweep.complete);
    EXPECT_EQ(sweep.period_ns, 100'000'000U);
    EXPECT_EQ(sweep.slices, 10);
    EXPECT_EQ(sweep.points.size(), 8U);
    EXPECT_EQ(sweep.points.front().time_ns, 0U);
    EXPECT_EQ(sweep.stamp_ns, kZero + static_cast<std::int64_t>(i) * 100 * kMs + 3'125'000);
  }
}

TEST(SpinningSweepsTest, ALineWaitsForItsAngles) {
  Rig rig;
  rig.read_until(10 * kMs);
  for (int i = 0; i < 4; ++i) rig.line(i);
  EXPECT_TRUE(rig.taken().empty());
  rig.read_until(200 * kMs);
  EXPECT_EQ(rig.taken().size(), 1U);
}

TEST(SpinningSweepsTest, AGapOfTheEncoderCostsItsLines) {
  Rig rig;
  rig.read_until(100 * kMs);
  rig.read_ns = 160 * kMs;
  rig.read_until(1100 * kMs);
  for (int i = 0; i < 12; ++i) rig.line(i);
  const auto sweeps = rig.taken();
  ASSERT_EQ(sweeps.size(), 3U);
  EXPECT_TRUE(sweeps[0].complete);
  EXPECT_FALSE(sweeps[1].complete);
  EXPECT_EQ(sweeps[1].packets_lost, rig.count("lines_without_angle"));
  EXPECT_GE(rig.count("lines_without_angle"), 3U);
}

TEST(SpinningSweepsTest, LostLinesLeaveTheirPlaceEmpty) {
  Rig rig;
  rig.read_until(1100 * kMs);
  rig.line(0);
  rig.line(3, 3);
  for (int i = 4; i < 8; ++i) rig.line(i);
  const auto sweeps = rig.taken();
  ASSERT_EQ(sweeps.size(), 2U);
  EXPECT_EQ(sweeps[0].packets_lost, 2U);
  EXPECT_FALSE(sweeps[0].complete);
  EXPECT_TRUE(sweeps[1].complete);
}

TEST(SpinningSweepsTest, SlowLinesFillNoLongerSweepThanItsTimesCanTell) {
  // Ten revolutions of 250 ms a line: two lines would be nearer to 3.9 s, but take 5 s.
  SpinningConfig config;
  config.turns = false;
  config.sweep_s = 3.9;
  SpinningSweeps sweeps(config);
  scip::Parameters slow = utm();
  slow.turns_per_minute = 240;
  for (int i = 0; i < 3; ++i) {
    scip::TimedScan line = line_of(2500 * kMs * i, {{180, 0, 2000, 0}, {900, 0, 2000, 0}});
    line.scan.request.skipped = 9;
    line.turns = i == 0 ? 1 : 10;
    sweeps.add(std::move(line), slow);
  }
  DecodedSweep sweep;
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(sweeps.take(sweep));
    EXPECT_EQ(sweep.period_ns, 2'500'000'000U);
    EXPECT_EQ(sweep.points.size(), 2U);
  }
}

TEST(SpinningSweepsTest, WithoutAnglesForASecondLinesAreGivenUp) {
  Rig rig;
  rig.read_until(50 * kMs);
  for (int i = 0; i < 100; ++i) rig.line(i);
  EXPECT_GT(rig.sweeps.without_angle_in_row(), 40U);
}

/// 90 degrees to either side at 180 degrees per second; a reversal takes 0.1 s.
MotorProfile swing_from(double from_s) { return {from_s, 180.0 * kDegree, 90.0 * kDegree, 0.1}; }

TEST(MotorProfileTest, ASwingBySomeOfItsInstants) {
  const MotorProfile profile = swing_from(1e-9 * static_cast<double>(kZero) + 0.25);
  EXPECT_DOUBLE_EQ(profile.turn_s(), 1.05);
  const auto degrees = [&](double s) {
    return profile.angle_rad(kZero + 250 * kMs + std::llround(1e9 * s)) / kDegree;
  };
  // 3600 degrees per second squared for 0.05 s, then 180 degrees per second.
  const std::vector<std::pair<double, double>> expected = {
      {0.0, -90.0},    {0.025, -88.875}, {0.05, -85.5}, {0.525, 0.0}, {1.0, 85.5},
      {1.025, 88.875}, {1.05, 90.0},     {1.1, 85.5},   {1.575, 0.0}, {2.1, -90.0},
      {21.525, 0.0},   {-0.05, -85.5},   {-0.525, 0.0}, {-1.05, 90.0}};
  for (const auto& [s, angle] : expected) EXPECT_NEAR(degrees(s), angle, 1e-4) << s;
}

TEST(MotorProfileTest, ATurningMotorGoesOn) {
  const MotorProfile profile{0.0, 250.0 * kDegree, 0.0, 0.0};
  EXPECT_DOUBLE_EQ(profile.turn_s(), 0.72);
  EXPECT_NEAR(profile.angle_rad(4 * 1000 * kMs), 1000.0 * kDegree, 1e-9);
  EXPECT_NEAR(profile.angle_rad(-1000 * kMs), -250.0 * kDegree, 1e-9);
}

TEST(SpinningSweepsTest, AProfileStandsForReadings) {
  SpinningConfig config;
  config.profile =
      MotorProfile{1e-9 * static_cast<double>(kZero) - 0.05, 180.0 * kDegree, 0.0, 0.0};
  config.mount.angle_delay_ns = 5 * kMs;
  // Step 900 (90 degrees to the left) is measured 5/8 of the scanner's revolution of 25 ms after
  // the line's stamp of 5 ms; the encoder's delay adds 5 ms.
  SpinningSweeps sweeps(config);
  sweeps.add(line_of(5 * kMs, {{900, 0, 4000, 0}}), utm());
  sweeps.flush();
  DecodedSweep sweep;
  ASSERT_TRUE(sweeps.take(sweep));
  ASSERT_EQ(sweep.points.size(), 1U);
  const double angle_rad = 180.0 * kDegree * (0.05 + 0.005 + 0.005 + 0.015625);
  expect_at(sweep.points.front(), 0.0, 4.0 * std::cos(angle_rad), 4.0 * std::sin(angle_rad));
}

std::string objection_to(const std::string& mount) {
  scip::ClientConfig client;
  SpinningConfig spinning;
  try {
    read_mount(mount, client, spinning);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return {};
}

TEST(MountFileTest, AProfileIsReadWhole) {
  scip::ClientConfig client;
  SpinningConfig spinning;
  read_mount(
      "motor: {profile: {from_s: 12.5, speed_deg_s: 180, amplitude_deg: 90, reversal_s: 0.1}}",
      client, spinning);
  ASSERT_TRUE(spinning.profile.has_value());
  EXPECT_DOUBLE_EQ(spinning.profile->from_s, 12.5);
  EXPECT_DOUBLE_EQ(spinning.turn_s, 1.05);
}

TEST(MountFileTest, WhatIsWrittenIsReadAgain) {
  const std::string text =
      "scanner: {rpy_deg: [90, -1.25, 2.5], xyz_m: [0.1, -0.02, 0.03], from_deg: -90, to_deg: 120,"
      " intensities: false, several_echoes: true, sweep_s: 0.2}\n"
      "motor: {axis: [0, 0, 2], zero_deg: 30.5, backward: true, delay_ms: 7.5, turn_s: 1.5}";
  scip::ClientConfig client, again_client;
  SpinningConfig spinning, again;
  read_mount(text, client, spinning);
  read_mount(mount_text(client, spinning), again_client, again);
  EXPECT_TRUE(again.mount.T_motor_scanner.isApprox(spinning.mount.T_motor_scanner, 1e-6));
  EXPECT_TRUE(again.mount.axis.isApprox(Eigen::Vector3d::UnitZ()));
  EXPECT_NEAR(again.mount.zero_rad, 30.5 * kDegree, 1e-6);
  EXPECT_EQ(again.mount.direction, -1.0);
  EXPECT_EQ(again.mount.angle_delay_ns, 7'500'000);
  EXPECT_DOUBLE_EQ(again.turn_s, 1.5);
  EXPECT_DOUBLE_EQ(again.sweep_s, 0.2);
  EXPECT_DOUBLE_EQ(again_client.from_deg, -90.0);
  EXPECT_DOUBLE_EQ(again_client.to_deg, 120.0);
  EXPECT_FALSE(again_client.intensities);
  EXPECT_TRUE(again_client.several_echoes);
}

TEST(MountFileTest, WhatIsWrongIsNamedByItsKey) {
  const std::vector<std::pair<std::string, std::string>> wrong = {
      {"motor: {profile: {speed_deg_s: 180}}", "motor.profile.from_s"},
      {"motor: {profile: {from_s: 1}}", "motor.profile.speed_deg_s"},
      {"motor: {profile: {from_s: 1, speed_deg_s: 0}}", "motor.profile.speed_deg_s"},
      {"motor: {profile: {from_s: 1, speed_deg_s: 180, reversal_s: 0.1}}",
       "motor.profile.reversal_s"},
      {"motor: {profile: {from_s: 1, speed_deg_s: 180, amplitude_deg: 5, reversal_s: 0.2}}",
       "motor.profile.reversal_s"},
      {"motor: {profile: {from_s: 1, speed_deg_s: 5}}", "motor.profile.speed_deg_s"},
      {"motor: {profile: {from_s: 1, speed_deg_s: 5, amplitude_deg: 90}}",
       "motor.profile.speed_deg_s"},
      {"motor: {turn_s: 1, profile: {from_s: 1, speed_deg_s: 180}}", "motor.turn_s"},
      {"motor: {profile: {from: 1}}", "motor.profile.from"},
      {"motor: {profile: 3}", "motor.profile"},
      {"motor: 3", "motor"},
      {"motor: {turn_s: [1]}", "motor.turn_s"},
      {"motor: {backward: true, backward: false}", "motor.backward"},
      {"motor: {turn_s: 1}\nscanner: {}\nmotor: {backward: true}\n", "motor"},
      {"motor: {? [turn_s, axis] : 1}", "motor.[turn_s, axis]"},
      {"? [scanner, motor]\n: {}\n", "[scanner, motor]"},
      {"motor: {profile: {? [from_s] : 1}}", "motor.profile.[from_s]"},
      {"scanner: {sweep_s: 3.91}", "scanner.sweep_s"},
      {"scanner: {sweep_s: 5}", "scanner.sweep_s"}};
  for (const auto& [text, key] : wrong) {
    EXPECT_EQ(objection_to(text).rfind(key + " ", 0), 0U) << text << ": " << objection_to(text);
  }
  EXPECT_EQ(objection_to("scanner: {sweep_s: 3.9}"), "");
}

TEST(MountFileTest, ATurnOfTheLongestTimeIsAllowedWhateverItsRounding) {
  const std::string swing = "motor: {profile: {from_s: 1, amplitude_deg: 18, speed_deg_s: ";
  EXPECT_EQ(objection_to(swing + "1.2}}"), "");
  EXPECT_EQ(objection_to(swing + "1.19}}"),
            "motor.profile.speed_deg_s is so slow that a turn takes more than 30 s");
}

TEST(AngleTrackTest, AnEncodersStepsAreSmoothedAwayFromReversals) {
  AngleTrack track;
  const double step = 0.25 * kDegree;
  const auto truth = [](double t_s) { return 180.0 * kDegree * t_s; };
  for (int i = 0; i < 200; ++i) {
    track.add({kZero + 2 * kMs * i, step * std::round(truth(0.002 * i) / step)});
  }
  double worst = 0.0;
  for (int i = 20; i < 380; ++i) {
    double angle = 0.0;
    ASSERT_EQ(track.at(kZero + kMs * i, angle), Angle::kKnown);
    worst = std::max(worst, std::abs(angle - truth(1e-3 * i)));
  }
  EXPECT_LT(worst, 0.3 * step);
}

TEST(AngleTrackTest, AReversalIsNotSmoothedOver) {
  AngleTrack track;
  for (int i = 0; i <= 100; ++i) {
    track.add({kZero + 2 * kMs * i, kDegree * (i <= 50 ? 0.36 * i : 36.0 - 0.36 * i)});
  }
  double angle = 0.0;
  ASSERT_EQ(track.at(kZero + 100 * kMs, angle), Angle::kKnown);
  EXPECT_NEAR(angle, 18.0 * kDegree, 0.05 * kDegree);
}

TEST(AngleTrackTest, AWrappedEncoderGoesOn) {
  AngleTrack track;
  for (int i = 0; i < 100; ++i) {
    track.add({kZero + 2 * kMs * i, std::remainder(0.1 * i, 2.0 * std::numbers::pi)});
  }
  double angle = 0.0;
  ASSERT_EQ(track.at(kZero + 101 * kMs, angle), Angle::kKnown);
  EXPECT_NEAR(angle, 5.05, 1e-9);
}

TEST(AngleTrackTest, WhatCantBeIsRefused) {
  AngleTrack track;
  track.add({kZero, 0.0});
  track.add({kZero, 1.0});
  track.add({kZero - 5, 1.0});
  track.add({kZero + 5, std::nan("")});
  EXPECT_EQ(track.received(), 4U);
  EXPECT_EQ(track.refused(), 3U);
  double angle = 0.0;
  EXPECT_EQ(track.at(kZero - 1, angle), Angle::kMissing);
  EXPECT_EQ(track.at(kZero + 1, angle), Angle::kNotYet);
}

}  // namespace
}  // namespace zloam::driver::spinning
