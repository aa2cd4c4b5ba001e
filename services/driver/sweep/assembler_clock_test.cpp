// The sensor's clock and the host's: steps, the hour, drift.
#include <gtest/gtest.h>

#include <cstdlib>

#include "driver/sweep/test_sweeps.hpp"

namespace zloam::driver {
namespace {

using test::assemble;
using test::expect_in_time_order;
using test::packets_of;
using test::Payload;
using test::sweeps_of;
using test::TurningSensor;

TEST(Assembler, OneStampFromElsewhereIsNoStep) {
  TurningSensor sensor;
  const std::vector<Payload> packets = packets_of(sensor, 200);
  std::vector<Payload> stream = packets;
  // 500 s before.
  stream[100][1203] = static_cast<std::uint8_t>(stream[100][1203] ^ 0x1d);
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (const Payload& packet : stream) assembler.add(packet, received_ns += 1'327'104);
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 0U);
  EXPECT_EQ(assembler.counts().late, 1U);
  EXPECT_EQ(assembler.counts().lost, 1U) << "its place stays empty";
  EXPECT_EQ(assembler.counts().decoded, 199U);
}

TEST(Assembler, APacketFromBeforeTheStepComesLate) {
  TurningSensor sensor;
  std::vector<Payload> stream = packets_of(sensor, 150);
  const Payload late = stream[148];
  stream.erase(stream.begin() + 148);
  sensor.time_us += 60e6;
  for (const Payload& packet : packets_of(sensor, 150)) stream.push_back(packet);
  stream.insert(stream.begin() + 151, late);
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (const Payload& packet : stream) assembler.add(packet, received_ns += 1'327'104);
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 1U);
  EXPECT_EQ(assembler.counts().late, 1U);
  EXPECT_EQ(assembler.counts().decoded, 299U);
}

TEST(Assembler, ASmallStepBackIsKnownByItsManyLatePackets) {
  TurningSensor sensor;
  std::vector<Payload> stream = packets_of(sensor, 150);
  sensor.time_us -= 200'300.0;
  for (const Payload& packet : packets_of(sensor, 300)) stream.push_back(packet);
  PacketCounts counts;
  const auto sweeps = assemble(stream, {}, &counts);
  EXPECT_EQ(counts.clock_steps, 1U);
  EXPECT_LE(counts.late, 16U);
  EXPECT_GE(counts.decoded, 434U);
  expect_in_time_order(sweeps);
}

TEST(Assembler, EightThousandSecondsGoOnOverTwoHours) {
  TurningSensor sensor;
  sensor.time_us = 3'000'000'000.0;
  SweepAssembler assembler({}, {.clock_mode = ClockMode::kUtc});
  // A packet each 0.9 s is enough. 1700002800 is a full hour.
  const std::int64_t start_ns = (1'700'002'800 + 3000) * 1'000'000'000LL;
  constexpr std::int64_t kStepNs = 900'000'000;
  constexpr std::int64_t kPackets = 8900;
  std::int64_t last = -1;
  DecodedSweep sweep;
  const auto check = [&] {
    // A packet over the seam makes two sweeps.
    while (assembler.take(sweep)) {
      const std::int64_t after_ns = sweep.stamp_ns - start_ns;
      ASSERT_LT(after_ns % kStepNs, 1'327'104);
      ASSERT_LE(after_ns / kStepNs - last, 1);
      last = after_ns / kStepNs;
    }
  };
  for (std::int64_t i = 0; i < kPackets; ++i) {
    sensor.time_us = 3e9 + 9e5 * static_cast<double>(i);
    assembler.add(sensor.next(), start_ns + kStepNs * i + 1'400'000);
    check();
  }
  assembler.flush();
  check();
  EXPECT_EQ(assembler.counts().clock_steps, 0U);
  EXPECT_EQ(last, kPackets - 1);
}

TEST(Assembler, AnOffsetShiftsEveryStamp) {
  TurningSensor sensor;
  const auto packets = packets_of(sensor, 200);
  const auto plain = assemble(packets);
  const auto shifted = assemble(packets, {.stamp_offset_ns = -542'592});
  ASSERT_EQ(plain.size(), shifted.size());
  for (std::size_t i = 0; i < plain.size(); ++i) {
    EXPECT_EQ(shifted[i].stamp_ns, plain[i].stamp_ns - 542'592);
  }
}

TEST(Assembler, AClockThatIsSetBeginsANewSweep) {
  TurningSensor sensor;
  std::vector<Payload> packets = packets_of(sensor, 150);
  sensor.time_us = 100'000.0;
  for (const Payload& packet : packets_of(sensor, 150)) packets.push_back(packet);
  PacketCounts counts;
  const auto sweeps = assemble(packets, {.clock_mode = ClockMode::kFreeRunning}, &counts);
  EXPECT_EQ(counts.clock_steps, 1U);
  EXPECT_EQ(counts.lost, 0U);
  EXPECT_EQ(counts.points, 300U * 384U);
  expect_in_time_order(sweeps);
}

TEST(Assembler, AStepForwardIsKnownByTheReceiveTimes) {
  TurningSensor sensor;
  SweepAssembler assembler({}, {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (int i = 0; i < 200; ++i) {
    if (i == 100) sensor.time_us += 60e6;
    assembler.add(sensor.next(), received_ns);
    received_ns += 1'327'104;
  }
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 1U);
  EXPECT_EQ(assembler.counts().lost, 0U);
  const auto sweeps = sweeps_of(assembler);
  expect_in_time_order(sweeps);
  EXPECT_NEAR(static_cast<double>(sweeps.back().stamp_ns), 1.7e18 + 0.2e9, 0.1e9);
}

TEST(Assembler, TheTopOfTheHourIsNoStep) {
  TurningSensor sensor;
  sensor.time_us = 3'599'900'000.0;
  const auto packets = packets_of(sensor, 300);
  PacketCounts counts;
  // 1700002800 is a full hour; the host's clock is 10 s off either way.
  for (const std::int64_t off_s : {-10, 0, 10}) {
    SCOPED_TRACE(off_s);
    SweepAssembler assembler({}, {.clock_mode = ClockMode::kUtc});
    std::int64_t received_ns = (1'700'002'799 + off_s) * 1'000'000'000 + 901'327'104;
    for (const Payload& packet : packets) {
      assembler.add(packet, received_ns);
      received_ns += 1'327'104;
    }
    assembler.flush();
    EXPECT_EQ(assembler.counts().lost, 0U);
    EXPECT_EQ(assembler.counts().clock_steps, 0U);
    const auto sweeps = sweeps_of(assembler);
    expect_in_time_order(sweeps);
    EXPECT_EQ(sweeps.front().stamp_ns, 1'700'002'799'900'000'000);
    EXPECT_NEAR(static_cast<double>(sweeps.back().stamp_ns - sweeps.front().stamp_ns), 3e8, 2e5);
  }
}

TEST(Assembler, ReceiveClockTiesTheFirstPacketAndFollowsDriftSlowly) {
  TurningSensor sensor;
  SweepAssembler receive({}, {.clock_mode = ClockMode::kReceive});
  SweepAssembler free_running({}, {.clock_mode = ClockMode::kFreeRunning});
  const std::int64_t start_ns = 1'700'000'000'000'000'000;
  // The sensor's clock is 50 ppm slow against the host's; 60 s.
  for (std::int64_t packet = 0; packet < 45'000; ++packet) {
    const auto received_ns =
        start_ns + static_cast<std::int64_t>(1'327'104.0 * 1.00005 * static_cast<double>(packet));
    const Payload payload = sensor.next();
    receive.add(payload, received_ns);
    free_running.add(payload, 0);
  }
  std::vector<std::int64_t> followed_ns;
  DecodedSweep tied;
  DecodedSweep sensor_only;
  while (receive.take(tied) && free_running.take(sensor_only)) {
    followed_ns.push_back(tied.stamp_ns - sensor_only.stamp_ns);
    const std::int64_t step_ns =
        followed_ns.back() - followed_ns[followed_ns.size() > 1 ? followed_ns.size() - 2 : 0];
    ASSERT_LE(std::abs(step_ns), 10'100) << "no jump between sweeps";
  }
  ASSERT_GT(followed_ns.size(), 500U);
  const std::int64_t all_ns = followed_ns.back() - followed_ns.front();
  EXPECT_GT(all_ns, 1'500'000) << "3 ms of drift must mostly be followed";
  EXPECT_LT(all_ns, 3'100'000);
}

TEST(Clock, R1HourRollover) {
  const auto at = [](double reference_s, std::int64_t toh_us) {
    return resolve_hour_ns(toh_us, static_cast<std::int64_t>(reference_s * 1e3) * 1'000'000);
  };
  EXPECT_EQ(at(1700002799.95, 3599999900), 1700002799999900000);
  EXPECT_EQ(at(1700002800.02, 3599999900), 1700002799999900000);
  EXPECT_EQ(at(1700002799.98, 100), 1700002800000100000);
  EXPECT_EQ(at(1700002800.02, 100), 1700002800000100000);
  EXPECT_EQ(at(1700001000.00, 3600050000), 1699999200050000000);
  EXPECT_EQ(at(1700000000.00, 1234567890), 1700000434567890000);
}

TEST(Clock, DifferencesGoAcrossTheHour) {
  EXPECT_EQ(toh_difference_us(100, 3'599'999'900U), 200);
  EXPECT_EQ(toh_difference_us(3'599'999'900U, 100), -200);
  EXPECT_EQ(toh_difference_us(51'000, 3'600'050'000U), 1000);
}

}  // namespace
}  // namespace zloam::driver
