#include "registration/packet_gap.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace zloam::registration {
namespace {

// VLP-16 manual 63-9243: 24 firings of 55.296 us in a packet of single returns.
constexpr double kPeriodNs = 24 * 55'296.0;
constexpr std::int64_t kHourNs = 3'600'000'000'000;

/// A sweep of this many packets; the first is number n since the sensor's start.
PacketSpan sweep_from(std::int64_t n, std::int64_t packets) {
  const auto toh_us = [](std::int64_t number) {
    const auto ns = static_cast<std::int64_t>(std::floor(kPeriodNs * static_cast<double>(number)));
    return static_cast<std::uint32_t>(ns % kHourNs / 1000);
  };
  const std::int64_t last = n + packets - 1;
  return {toh_us(n), toh_us(last), static_cast<std::uint32_t>(kPeriodNs),
          static_cast<std::int64_t>(kPeriodNs * static_cast<double>(last))};
}

TEST(PacketGap, NothingIsMissingBetweenNeighbours) {
  EXPECT_EQ(packets_between(sweep_from(0, 76), sweep_from(76, 75)), 0);
}

TEST(PacketGap, CountsExactlyOverSecondsAndMinutes) {
  for (const std::int64_t missing : {1, 2, 75, 754, 45'213, 1'000'000}) {
    EXPECT_EQ(packets_between(sweep_from(7, 76), sweep_from(83 + missing, 75)), missing);
  }
}

TEST(PacketGap, GoesOverTheTopOfTheHourAndOverHours) {
  const auto per_hour = static_cast<std::int64_t>(static_cast<double>(kHourNs) / kPeriodNs);
  const PacketSpan before = sweep_from(per_hour - 100, 76);
  EXPECT_EQ(packets_between(before, sweep_from(per_hour + 476, 75)), 500);
  EXPECT_EQ(packets_between(before, sweep_from(3 * per_hour - 24 + 9, 75)), 2 * per_hour + 9);
}

TEST(PacketGap, APacketInBothSweepsIsNotMissing) {
  EXPECT_EQ(packets_between(sweep_from(0, 76), sweep_from(75, 75)), 0);
}

TEST(PacketGap, SourcesWithoutPacketsHaveNone) {
  PacketSpan scan = sweep_from(500, 75);
  scan.period_ns = 0;
  EXPECT_EQ(packets_between(sweep_from(0, 76), scan), 0);
  EXPECT_EQ(packets_between(scan, sweep_from(700, 76)), 0);
}

}  // namespace
}  // namespace zloam::registration
