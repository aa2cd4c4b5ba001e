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
  // 500 s earlier.
  stream[100][1203] = static_cast<std::uint8_t>(stream[100][1203] ^ 0x1d);
  SweepAssembler assembler(test::decoder(), {});
  std::int64_t received_ns = 1'700'000'000'000'000'000;
  for (const Payload& packet : stream) assembler.add(packet, received_ns += 1'327'104);
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 0U);
  EXPECT_EQ(assembler.counts().late, 1U);
  EXPECT_EQ(assembler.counts().lost, 1U) << "its place stays empty";
  EXPECT_EQ(assembler.counts().decoded, 199U);
}

TEST(Assembler, AFirstStampFromElsewhereMovesNoOther) {
  constexpr std::int64_t kFirstNs = 1'700'000'000'000'000'000;
  constexpr std::int64_t kPeriodNs = 1'327'104;
  for (const double apart_us : {-900e6, 100e6, 2000e6}) {
    SCOPED_TRACE(apart_us);
    TurningSensor elsewhere, sensor;
    sensor.time_us = 1000e6;
    elsewhere.time_us = sensor.time_us + apart_us;
    std::vector<Payload> stream = packets_of(elsewhere, 1);
    for (const Payload& packet : packets_of(sensor, 299)) stream.push_back(packet);
    SweepAssembler assembler(test::decoder(), {});
    std::int64_t received_ns = kFirstNs;
    for (const Payload& packet : stream) assembler.add(packet, received_ns += kPeriodNs);
    assembler.flush();
    EXPECT_EQ(assembler.counts().clock_steps, 1U);
    EXPECT_EQ(assembler.counts().lost, 0U);
    EXPECT_EQ(assembler.counts().reordered, 0U);
    EXPECT_EQ(assembler.counts().decoded, 300U);
    const auto sweeps = sweeps_of(assembler);
    expect_in_time_order(sweeps);
    const auto from_end_ns = static_cast<double>(received_ns - sweeps.back().stamp_ns);
    EXPECT_NEAR(from_end_ns, 0.05e9, 0.06e9);
  }
}

TEST(Assembler, APacketFromBeforeTheStepComesLate) {
  TurningSensor sensor;
  std::vector<Payload> stream = packets_of(sensor, 150);
  const Payload late = stream[148];
  stream.erase(stream.begin() + 148);
  sensor.time_us += 60e6;
  for (const Payload& packet : packets_of(sensor, 150)) stream.push_back(packet);
  stream.insert(stream.begin() + 151, late);
  SweepAssembler assembler(test::decoder(), {});
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
  SweepAssembler assembler(test::decoder(), {.clock_mode = ClockMode::kUtc});
  // One packet every 0.9 s suffices. 1700002800 is a full hour.
  const std::int64_t start_ns = (1'700'002'800 + 3000) * 1'000'000'000LL;
  constexpr std::int64_t kStepNs = 900'000'000;
  constexpr std::int64_t kPackets = 8900;
  std::int64_t last = -1;
  DecodedSweep sweep;
  const auto check = [&] {
    // A packet across the seam feeds two sweeps.
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
  SweepAssembler assembler(test::decoder(), {});
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

constexpr std::int64_t kStartNs = 1'700'000'000'000'000'000;
constexpr std::int64_t kPacketNs = 1'327'104;
constexpr std::int64_t kSecondNs = 1'000'000'000;

/// Passes ideal packets to an assembler; received_ns maps the send time to the receive time.
template <class Received>
std::vector<DecodedSweep> received_as(Received received_ns, std::int64_t packets,
                                      PacketCounts* counts) {
  TurningSensor sensor;
  SweepAssembler assembler(test::decoder(), {});
  for (std::int64_t i = 0; i < packets; ++i) {
    assembler.add(sensor.next(), received_ns(kStartNs + kPacketNs * (i + 1)));
  }
  assembler.flush();
  *counts = assembler.counts();
  return sweeps_of(assembler);
}

/// Checks that intervals are those of the sensor's clock: drift is followed by at most 100 parts in
/// a million.
void expect_the_sensors_own_times(const std::vector<DecodedSweep>& sweeps) {
  expect_in_time_order(sweeps);
  for (std::size_t i = 2; i + 1 < sweeps.size(); ++i) {
    ASSERT_NEAR(static_cast<double>(sweeps[i].stamp_ns - sweeps[i - 1].stamp_ns), 1e8, 1.4e5);
    ASSERT_TRUE(sweeps[i].complete);
  }
}

TEST(AssemblerClock, PacketsThatWereHeldUpChangeNoTime) {
  for (const std::int64_t hold_ns : {800'000'000LL, 5'000'000'000LL}) {
    SCOPED_TRACE(hold_ns);
    PacketCounts counts;
    const auto sweeps = received_as(
        [&](std::int64_t sent_ns) {
          const std::int64_t from_ns = kStartNs + 3 * kSecondNs;
          const bool held = sent_ns >= from_ns && sent_ns < from_ns + hold_ns;
          return held ? from_ns + hold_ns + (sent_ns - from_ns) / 500 : sent_ns;
        },
        9000, &counts);
    EXPECT_EQ(counts.clock_steps, 0U);
    EXPECT_EQ(counts.host_clock_steps, 0U);
    EXPECT_EQ(counts.lost + counts.late, 0U);
    expect_the_sensors_own_times(sweeps);
    EXPECT_EQ(sweeps.front().stamp_ns, kStartNs);
  }
}

/// 300 packets before a silence of the sensor, and 300 after it.
std::vector<DecodedSweep> across_silence(std::int64_t silent_ns, bool was_off,
                                         PacketCounts* counts) {
  TurningSensor sensor;
  SweepAssembler assembler(test::decoder(), {});
  for (std::int64_t i = 0; i < 600; ++i) {
    if (i == 300) {
      sensor.time_us = was_off ? 7e6 : sensor.time_us + 1e-3 * static_cast<double>(silent_ns);
    }
    assembler.add(sensor.next(), kStartNs + kPacketNs * (i + 1) + (i >= 300 ? silent_ns : 0));
  }
  assembler.flush();
  *counts = assembler.counts();
  return sweeps_of(assembler);
}

TEST(AssemblerClock, ASilenceOfHoursTakesItsTime) {
  for (const std::int64_t silent_s : {1700LL, 2700LL, 3500LL, 3660LL, 5500LL, 10'000LL}) {
    for (const bool was_off : {false, true}) {
      SCOPED_TRACE(silent_s);
      SCOPED_TRACE(was_off);
      PacketCounts counts;
      const auto sweeps = across_silence(silent_s * kSecondNs, was_off, &counts);
      if (!was_off) {
        EXPECT_EQ(counts.clock_steps, 0U);
      }
      EXPECT_EQ(counts.host_clock_steps, 0U);
      expect_in_time_order(sweeps);
      const std::int64_t lasted_ns = sweeps.back().stamp_ns - sweeps.front().stamp_ns;
      // 600 packets are almost eight revolutions of 0.1 s.
      const double off_s = 1e-9 * static_cast<double>(lasted_ns) - static_cast<double>(silent_s);
      if (!was_off || silent_s > 1800) {
        EXPECT_NEAR(off_s, 0.75, 0.1);
      }
    }
  }
}

TEST(AssemblerClock, AHostThatIsSetIsSaidAndMovesNoStamp) {
  for (const std::int64_t step_s : {2LL, -1LL, -30LL, 3600LL, 7200LL, 1'700'000'000LL}) {
    SCOPED_TRACE(step_s);
    PacketCounts counts;
    const auto sweeps = received_as(
        [&](std::int64_t sent_ns) {
          const std::int64_t host_ns = step_s > 1000 ? sent_ns - kStartNs + kSecondNs : sent_ns;
          return sent_ns < kStartNs + 5 * kSecondNs ? host_ns : host_ns + step_s * kSecondNs;
        },
        12'000, &counts);
    EXPECT_EQ(counts.clock_steps, 0U);
    EXPECT_EQ(counts.host_clock_steps, 1U);
    EXPECT_EQ(counts.lost + counts.late, 0U);
    expect_the_sensors_own_times(sweeps);
    std::int64_t said_ns = 0;
    for (const DecodedSweep& sweep : sweeps) said_ns += sweep.host_clock_step_ns;
    EXPECT_NEAR(1e-9 * static_cast<double>(said_ns), static_cast<double>(step_s), 1e-3);
  }
}

TEST(AssemblerClock, ReceiveTimesOfWholeSecondsGiveTheTrueStart) {
  PacketCounts counts;
  // The first packet arrives 0.7 s before the receiver's second changes.
  const auto sweeps = received_as(
      [](std::int64_t sent_ns) { return (sent_ns + 300'000'000) / kSecondNs * kSecondNs; }, 12'000,
      &counts);
  EXPECT_EQ(counts.clock_steps + counts.host_clock_steps + counts.lost, 0U);
  expect_the_sensors_own_times(sweeps);
}

TEST(AssemblerClock, ReceiveTimesThatStandStillAreNoClock) {
  PacketCounts counts;
  const auto sweeps = received_as([](std::int64_t) { return kStartNs; }, 12'000, &counts);
  EXPECT_EQ(counts.clock_steps + counts.host_clock_steps + counts.lost, 0U);
  expect_the_sensors_own_times(sweeps);
  EXPECT_NEAR(static_cast<double>(sweeps.back().stamp_ns - sweeps.front().stamp_ns),
              12'000.0 * kPacketNs, 1e8);
}

TEST(AssemblerClock, LostInABurstIsLostAndASensorThatIsSetTakesAsLongAsTheHostWaited) {
  TurningSensor sensor;
  SweepAssembler lossy(test::decoder(), {});
  for (std::int64_t i = 0; i < 4000; ++i) {
    const Payload packet = sensor.next();
    const std::int64_t sent_ns = kStartNs + kPacketNs * (i + 1);
    // The receiver holds packets up for 2 s and loses those of the first 1.5 s.
    const bool held = i >= 1000 && i < 2500;
    if (i < 1000 || i >= 2130) lossy.add(packet, held ? kStartNs + kPacketNs * 2501 : sent_ns);
  }
  lossy.flush();
  EXPECT_EQ(lossy.counts().clock_steps, 0U);
  EXPECT_EQ(lossy.counts().lost, 1130U);
  expect_in_time_order(sweeps_of(lossy));

  TurningSensor restarted;
  restarted.time_us = 2'000e6;
  SweepAssembler assembler(test::decoder(), {});
  for (std::int64_t i = 0; i < 300; ++i) {
    assembler.add(restarted.next(), kStartNs + kPacketNs * (i + 1));
  }
  restarted.time_us = 5e6;
  const std::int64_t again_ns = kStartNs + 20 * kSecondNs;
  for (std::int64_t i = 0; i < 300; ++i) {
    assembler.add(restarted.next(), again_ns + kPacketNs * (i + 1));
  }
  assembler.flush();
  EXPECT_EQ(assembler.counts().clock_steps, 1U);
  const auto sweeps = sweeps_of(assembler);
  std::int64_t step_ns = 0;
  for (const DecodedSweep& sweep : sweeps) {
    step_ns += sweep.sensor_clock_step_ns;
    if (sweep.sensor_clock_step_ns == 0) continue;
    EXPECT_NEAR(static_cast<double>(sweep.stamp_ns - again_ns), 0.0, 2e6);
  }
  EXPECT_NEAR(1e-9 * static_cast<double>(step_ns), 5.0 - 2000.0 - 19.6 + 3600.0, 0.5);
}

TEST(Assembler, TheTopOfTheHourIsNoStep) {
  TurningSensor sensor;
  sensor.time_us = 3'599'900'000.0;
  const auto packets = packets_of(sensor, 300);
  PacketCounts counts;
  // 1700002800 is a full hour; the host's clock is up to 10 s off in either direction.
  for (const std::int64_t off_s : {-10, 0, 10}) {
    SCOPED_TRACE(off_s);
    SweepAssembler assembler(test::decoder(), {.clock_mode = ClockMode::kUtc});
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
  SweepAssembler receive(test::decoder(), {.clock_mode = ClockMode::kReceive});
  SweepAssembler free_running(test::decoder(), {.clock_mode = ClockMode::kFreeRunning});
  const std::int64_t start_ns = 1'700'000'000'000'000'000;
  // Over 60 s, the sensor's clock is slow by 50 parts in a million against the host's.
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
