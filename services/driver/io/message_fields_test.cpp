#include "driver/io/message_fields.hpp"

#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "schemas/packets_generated.h"
#include "schemas/sweep_generated.h"

namespace zloam::driver {
namespace {

TEST(MessageFields, ModesAndClocksAreTheMessages) {
  DecodedSweep sweep;
  sweep.return_mode = ReturnMode::kDual;
  for (const auto& [own, message] :
       {std::pair{ClockSource::kSensorGps, msg::ClockSource::SensorGps},
        std::pair{ClockSource::kSensorFreeRunning, msg::ClockSource::SensorFreeRunning},
        std::pair{ClockSource::kHost, msg::ClockSource::Host},
        std::pair{ClockSource::kCapture, msg::ClockSource::Capture},
        std::pair{ClockSource::kSynthetic, msg::ClockSource::Synthetic}}) {
    sweep.clock_source = own;
    EXPECT_EQ(fields_of(sweep).clock_source, message);
  }
  EXPECT_EQ(fields_of(sweep).return_mode, msg::ReturnMode::Dual);
  sweep.return_mode = ReturnMode::kLast;
  EXPECT_EQ(fields_of(sweep).return_mode, msg::ReturnMode::Last);
}

TEST(MessageFields, AnEmptySweepIsSaidBeforeAnIncompleteOne) {
  DecodedSweep sweep;
  EXPECT_EQ(fields_of(sweep).health, Health::kEmpty);
  sweep.points.emplace_back();
  EXPECT_EQ(fields_of(sweep).health, Health::kIncomplete);
  sweep.complete = true;
  EXPECT_EQ(fields_of(sweep).health, Health::kOk);
  EXPECT_EQ(fields_of(sweep).points.size(), 1U);
}

/// Fields with arbitrary values survive the round trip.
TEST(MessageFields, ASweepIsReadBackAsItWas) {
  std::mt19937 random(7);
  DecodedSweep sweep;
  for (std::uint16_t i = 0; i < 50; ++i) {
    Point p;
    p.x = static_cast<float>(random());
    p.time_ns = 1000U * i;
    p.ring = static_cast<std::uint16_t>(i % 16);
    p.return_type = static_cast<ReturnType>(i % 4);
    sweep.points.push_back(p);
    sweep.columns.push_back(static_cast<std::uint16_t>(i / 16));
  }
  sweep.stamp_ns = 1'700'000'000'123'456'789;
  sweep.period_ns = 99'876'543;
  sweep.rings = 16;
  sweep.model = "VLP-16";
  sweep.return_mode = ReturnMode::kDual;
  sweep.clock_source = ClockSource::kSensorGps;
  sweep.complete = true;
  sweep.packets = 76;
  sweep.packets_lost = 3;
  sweep.deskewed = true;
  sweep.first_packet_toh_us = 5;
  sweep.last_packet_toh_us = 99'005;
  sweep.packet_period_ns = 1'327'104;
  sweep.host_clock_step_ns = -5;
  sweep.sensor_clock_step_ns = 6;
  HeaderFields header;
  header.stamp_ns = sweep.stamp_ns;
  const auto message = build(header, fields_of(sweep));
  const DecodedSweep read = sweep_of(*flatbuffers::GetRoot<msg::Sweep>(message.data()));
  ASSERT_EQ(read.points.size(), sweep.points.size());
  EXPECT_EQ(
      std::memcmp(read.points.data(), sweep.points.data(), sweep.points.size() * sizeof(Point)), 0);
  EXPECT_EQ(read.columns, sweep.columns);
  EXPECT_EQ(read.stamp_ns, sweep.stamp_ns);
  // For all other fields: the rebuilt message has the same bytes.
  const auto again = build(header, fields_of(read));
  ASSERT_EQ(again.size(), message.size());
  EXPECT_EQ(std::memcmp(again.data(), message.data(), message.size()), 0);
}

TEST(MessageFields, ASentenceIsReadWhereItTellsThePlace) {
  ReceivedPosition position;
  position.received_ns = 5;
  position.packet.pps = Pps::kLocked;
  position.packet.nmea = "$GPRMC,220516,A,5133.82,N,00042.24,W,173.8,231.8,130624,004.2,W*7B";
  const GnssFixFields fix = fields_of(position);
  EXPECT_EQ(fix.received_ns, 5);
  EXPECT_EQ(fix.pps, msg::PpsStatus::Locked);
  // 2024-06-13 22:05:16 UTC
  EXPECT_EQ(fix.utc_ns, 1718'316'316'000'000'000);
  EXPECT_NEAR(fix.latitude_deg, 51.0 + 33.82 / 60.0, 1e-9);
  EXPECT_NEAR(fix.longitude_deg, -42.24 / 60.0, 1e-9);
  EXPECT_TRUE(fix.valid);
  EXPECT_EQ(fix.sentence, position.packet.nmea);

  position.packet.nmea = "$GPGGA,220516,5133.82,N,00042.24,W,1,08,0.9,50.0,M,46.9,M,,*XX";
  const GnssFixFields other = fields_of(position);
  EXPECT_EQ(other.sentence, position.packet.nmea);
  EXPECT_EQ(other.utc_ns, 0);
  EXPECT_FALSE(other.valid);
}

}  // namespace
}  // namespace zloam::driver
