#include "driver/imu/imu_buffer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "common/geometry/se3.hpp"

namespace zloam::driver {
namespace {

constexpr double kG = 9.80665;

ImuReading at(std::int64_t stamp_ms, const Eigen::Vector3d& force = {0.0, 0.0, kG}) {
  return {stamp_ms * 1'000'000, force, Eigen::Vector3d::Zero()};
}

std::vector<std::int64_t> stamps_ms(const std::vector<ImuReading>& readings) {
  std::vector<std::int64_t> out;
  for (const ImuReading& r : readings) out.push_back(r.stamp_ns / 1'000'000);
  return out;
}

using Stamps = std::vector<std::int64_t>;

TEST(ImuBuffer, GivesWhatCoversASweepWithItsMargin) {
  ImuBuffer buffer(0);
  for (int t = 0; t <= 400; t += 5) buffer.add(at(t));
  const Stamps first = stamps_ms(buffer.covering(100'000'000, 200'000'000));
  EXPECT_EQ(first.front(), 70);
  EXPECT_EQ(first.back(), 230);
  EXPECT_EQ(first.size(), 33U);
  // The readings at the next sweep's begin are still buffered.
  const Stamps second = stamps_ms(buffer.covering(200'000'000, 300'000'000));
  EXPECT_EQ(second.front(), 170);
  EXPECT_EQ(second.back(), 330);
}

TEST(ImuBuffer, TellsWhetherASweepIsCovered) {
  ImuBuffer buffer(0);
  EXPECT_FALSE(buffer.reaches(100'000'000));
  buffer.add(at(95));
  EXPECT_FALSE(buffer.reaches(100'000'000));
  buffer.add(at(100));
  EXPECT_TRUE(buffer.reaches(100'000'000));
}

TEST(ImuBuffer, TakesTheDelayOffTheStamps) {
  ImuBuffer buffer(20'000'000);
  for (int t = 0; t <= 400; t += 5) buffer.add(at(t));
  const Stamps stamps = stamps_ms(buffer.covering(100'000'000, 200'000'000));
  EXPECT_EQ(stamps.front(), 70);
  EXPECT_EQ(stamps.back(), 230);
}

TEST(ImuBuffer, LeavesOutWhatIsOutOfOrderOrNotFinite) {
  ImuBuffer buffer(0);
  buffer.add(at(10));
  buffer.add(at(20));
  buffer.add(at(15));
  buffer.add(at(20));
  buffer.add(at(25, {0.0, std::numeric_limits<double>::quiet_NaN(), 0.0}));
  buffer.add(at(30));
  EXPECT_EQ(stamps_ms(buffer.covering(0, 40'000'000)), (Stamps{10, 20, 30}));
  EXPECT_EQ(buffer.out_of_order(), 2U);
  EXPECT_EQ(buffer.invalid(), 1U);
  EXPECT_EQ(buffer.received(), 6U);
}

// Damaged bytes make any number. Registration refuses the whole sweep because of one such reading.
TEST(ImuBuffer, LeavesOutWhatASweepMayNotContain) {
  ImuBuffer buffer(0);
  buffer.add(at(10));
  EXPECT_FALSE(buffer.add(at(20, {0.0, 0.0, 1e30})));
  ImuReading spinning = at(30);
  spinning.rate_radps.x() = -2e6;
  EXPECT_FALSE(buffer.add(spinning));
  EXPECT_TRUE(buffer.add(at(40, {0.0, 1e6, 0.0})));
  EXPECT_EQ(stamps_ms(buffer.covering(0, 40'000'000)), (Stamps{10, 40}));
  EXPECT_EQ(buffer.invalid(), 2U);
}

TEST(ImuBuffer, BeginsAnewWhenItsClockIsSetBack) {
  ImuBuffer buffer(0);
  buffer.add(at(5000));
  buffer.add(at(100));
  buffer.add(at(105));
  EXPECT_EQ(stamps_ms(buffer.covering(95'000'000, 105'000'000)), (Stamps{100, 105}));
}

TEST(ImuBuffer, KeepsNoMoreThanItMayWhileNoSweepTakesReadings) {
  ImuBuffer buffer(0, 3);
  for (int t = 10; t <= 60; t += 10) buffer.add(at(t));
  EXPECT_EQ(stamps_ms(buffer.covering(0, 60'000'000)), (Stamps{40, 50, 60}));
  EXPECT_EQ(buffer.unused(), 3U);
}

std::string said_of(const Eigen::Vector3d& force, const Eigen::Vector3d& rpy_deg = {0, 0, 0}) {
  return wrong_units({at(0, force), at(5, force)},
                     pose_from_xyz_rpy_deg({0, 0, 0}, rpy_deg).linear());
}

// A sensor at rest (REP 145): level, rolled by 10 degrees, pitched by 20 degrees, rolled and
// pitched.
TEST(WrongUnits, NothingIsSaidOfTheSpecificationsAttitudes) {
  EXPECT_EQ(said_of({0.0, 0.0, 9.81}), "");
  EXPECT_EQ(said_of({0.0, 1.70349, 9.66096}), "");
  EXPECT_EQ(said_of({-3.35522, 0.0, 9.21838}), "");
  EXPECT_EQ(said_of({4.14589, 2.30113, 8.58793}), "");
}

TEST(WrongUnits, UnitsOfGravityAndItsSignAreNamed) {
  EXPECT_NE(said_of({0.0, 0.0, 1.0}).find("in g"), std::string::npos);
  EXPECT_NE(said_of({0.0, 0.0, -9.81}).find("sign"), std::string::npos);
  EXPECT_NE(said_of({0.01, 0.0, -0.02}).find("without gravity"), std::string::npos);
  EXPECT_NE(said_of({0.0, 0.0, 33000.0}).find("uncalibrated"), std::string::npos);
}

// The buffer drops such a reading, so that the others of the file can be used.
TEST(WrongUnits, ADamagedReadingDoesNotJudgeTheOthers) {
  const auto said = [](double damaged, double force) {
    return wrong_units({at(0, {0.0, 0.0, force}), at(5, {0.0, 0.0, damaged})},
                       Eigen::Matrix3d::Identity());
  };
  EXPECT_EQ(said(1e30, 9.81), "");
  EXPECT_NE(said(1e30, 1.0).find("in g"), std::string::npos);
  EXPECT_NE(said(std::nan(""), 1.0).find("in g"), std::string::npos);
  EXPECT_EQ(said(1e30, -1e30), "");
  // The same damage may leave the force just possible.
  ImuReading spinning = at(5, {0.0, 0.0, 1e5});
  spinning.rate_radps.x() = 1e30;
  EXPECT_EQ(wrong_units({at(0, {0.0, 0.0, 9.81}), spinning}, Eigen::Matrix3d::Identity()), "");
}

/// Verdict on readings that a buffer accepts.
UnitsJudge judged(const std::vector<ImuReading>& readings) {
  ImuBuffer buffer(0, 20'000);
  UnitsJudge units(Eigen::Matrix3d::Identity());
  for (const ImuReading& r : readings) {
    if (buffer.add(r)) units.add(r);
  }
  return units;
}

std::vector<ImuReading> two_seconds(double force_mps2) {
  std::vector<ImuReading> readings;
  for (int t = 0; t < 2000; t += 5) readings.push_back(at(t, {0.0, 0.0, force_mps2}));
  return readings;
}

TEST(UnitsJudge, AReadingFromAnotherTimePutsNothingOff) {
  std::vector<ImuReading> readings = two_seconds(1.0);
  readings.insert(readings.begin(), at(3'600'000, {0.0, 0.0, 1.0}));
  const UnitsJudge units = judged(readings);
  EXPECT_TRUE(units.judged());
  EXPECT_NE(units.wrong().find("in g"), std::string::npos);
}

TEST(UnitsJudge, WrongReadingsAreKnownBeforeTheSecondIsOver) {
  std::vector<ImuReading> readings = two_seconds(1.0);
  readings.resize(3);
  EXPECT_FALSE(judged(readings).judged());
  EXPECT_NE(judged(readings).wrong(), "");
  EXPECT_EQ(judged(two_seconds(kG)).wrong(), "");
  EXPECT_TRUE(judged(two_seconds(kG)).judged());
}

TEST(UnitsJudge, StampsThatHardlyAdvanceEndTheTrialToo) {
  std::vector<ImuReading> readings(10'000, at(0, {0.0, 0.0, 1.0}));
  EXPECT_FALSE(judged(readings).judged()) << "a single reading is accepted";
  for (std::size_t i = 0; i < readings.size(); ++i) {
    readings[i].stamp_ns = static_cast<std::int64_t>(i);
  }
  EXPECT_TRUE(judged(readings).judged());
}

TEST(WrongUnits, TheMountingIsTakenIntoAccount) {
  EXPECT_EQ(said_of({0.0, 0.0, -9.81}, {180.0, 0.0, 0.0}), "");
  EXPECT_NE(said_of({0.0, 0.0, 9.81}, {180.0, 0.0, 0.0}), "");
}

}  // namespace
}  // namespace zloam::driver
