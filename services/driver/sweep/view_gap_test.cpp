// Restricted fields of view, of sensors whose packets have few firing groups or are stamped at
// their end.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <iterator>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "driver/hesai/hesai.hpp"
#include "driver/hesai/test_packets.hpp"
#include "driver/sweep/test_sweeps.hpp"
#include "driver/velodyne/test_calibration.hpp"
#include "driver/velodyne/velodyne.hpp"

namespace zloam::driver {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr double kFirstDeg = 90.0;
constexpr double kLastDeg = 180.0;
constexpr double kTurnUs = 100'000.0;
constexpr unsigned kRaw = 2500;

struct Fired {
  int azimuth_cdeg = 0;
  double at_us = 0.0;
};

/// A sensor at 600 rpm: its firing groups, and how it packs them.
struct Sensor {
  const char* name;
  double group_us;
  std::size_t groups;
  std::function<Bytes(const std::vector<Fired>&)> packed;
  DecodingOptions options = {};
  bool hesai = false;
};

void put_stamp(Bytes& packet, double toh_us) {
  const auto stamp_us = static_cast<std::uint32_t>(toh_us);
  for (std::size_t i = 0; i < 4; ++i) {
    packet[1200 + i] = static_cast<std::uint8_t>(stamp_us >> (8 * i));
  }
}

/// Groups of equal size; flag_of: the bank of a group's block.
Bytes velodyne_packet(const std::vector<Fired>& fired, std::size_t blocks_per_group,
                      const std::function<std::size_t(std::size_t)>& bank_of,
                      const std::array<std::uint8_t, 2>& mode_and_product) {
  constexpr std::array<std::uint8_t, 4> kFlags = {0xEE, 0xDD, 0xCC, 0xBB};
  Bytes packet(velodyne::kDataPacketBytes, 0);
  for (std::size_t k = 0; k < fired.size() * blocks_per_group; ++k) {
    const int azimuth_cdeg = fired[k / blocks_per_group].azimuth_cdeg;
    packet[100 * k] = 0xFF;
    packet[100 * k + 1] = kFlags[bank_of(k % blocks_per_group)];
    packet[100 * k + 2] = static_cast<std::uint8_t>(azimuth_cdeg & 0xFF);
    packet[100 * k + 3] = static_cast<std::uint8_t>(azimuth_cdeg >> 8);
    for (std::size_t c = 0; c < 32; ++c) {
      packet[100 * k + 4 + 3 * c] = static_cast<std::uint8_t>(kRaw & 0xFF);
      packet[100 * k + 5 + 3 * c] = static_cast<std::uint8_t>(kRaw >> 8);
    }
  }
  packet[1204] = mode_and_product[0];
  packet[1205] = mode_and_product[1];
  return packet;
}

Bytes vls128_single(const std::vector<Fired>& fired) {
  Bytes packet = velodyne_packet(fired, 4, [](std::size_t b) { return b; }, {0x37, 0xA1});
  put_stamp(packet, fired.front().at_us);
  return packet;
}

Bytes vls128_dual(const std::vector<Fired>& fired) {
  Bytes packet = velodyne_packet(fired, 8, [](std::size_t b) { return b / 2; }, {0x39, 0xA1});
  put_stamp(packet, fired.front().at_us);
  return packet;
}

/// The stamp is the packet's end.
Bytes hdl64e_dual(const std::vector<Fired>& fired) {
  Bytes packet = velodyne_packet(fired, 4, [](std::size_t b) { return b % 2; }, {0x48, 0x0C});
  put_stamp(packet, fired.back().at_us + 57.6);
  return packet;
}

/// The stamp is that of the last group.
Bytes xt32_dual(const std::vector<Fired>& fired) {
  Bytes packet =
      hesai::test::packet(32, 0x39, static_cast<std::uint32_t>(fired.back().at_us), 0.0, 0.0);
  for (int block = 0; block < 8; ++block) {
    const Fired& group = fired[static_cast<std::size_t>(block / 2)];
    hesai::test::put_u16(packet, hesai::test::cell_at(32, block, 0) - 2,
                         static_cast<unsigned>(group.azimuth_cdeg));
    for (int laser = 0; laser < 32; ++laser) {
      hesai::test::set_cell(packet, 32, block, laser, kRaw, 9);
    }
  }
  return packet;
}

std::vector<Sensor> sensors() {
  DecodingOptions hdl64e;
  hdl64e.model = "HDL-64E S3";
  hdl64e.metadata = velodyne::test::calibration_yaml();
  hdl64e.metadata_name = "unit.yaml";
  return {{"VLS-128", 57.8, 3, vls128_single},
          {"VLS-128 dual", 57.8, 1, vls128_dual},
          {"HDL-64E S3 dual", 57.6, 3, hdl64e_dual, hdl64e},
          {"PandarXT-32 dual", 50.0, 4, xt32_dual, {}, true}};
}

/// The firing groups of each packet.
std::vector<std::vector<Fired>> fired_in_view(const Sensor& sensor, double seconds,
                                              double first_deg, double last_deg) {
  std::vector<std::vector<Fired>> packets;
  std::vector<Fired> fired;
  const auto count = static_cast<std::int64_t>(1e6 * seconds / sensor.group_us);
  for (std::int64_t i = 0; i < count; ++i) {
    const double after_us = sensor.group_us * static_cast<double>(i);
    // It begins in the middle of the view.
    const double azimuth_deg = std::fmod(130.0 + 360.0 * after_us / kTurnUs, 360.0);
    if (azimuth_deg < first_deg || azimuth_deg >= last_deg) continue;
    fired.push_back({static_cast<int>(100.0 * azimuth_deg), 1e6 + after_us});
    if (fired.size() < sensor.groups) continue;
    packets.push_back(fired);
    fired.clear();
  }
  return packets;
}

std::vector<Bytes> packed(const Sensor& sensor, const std::vector<std::vector<Fired>>& fired) {
  std::vector<Bytes> packets;
  packets.reserve(fired.size());
  for (const std::vector<Fired>& groups : fired) packets.push_back(sensor.packed(groups));
  return packets;
}

std::unique_ptr<PacketDecoder> decoder_of(const Sensor& sensor, const std::vector<Bytes>& packets) {
  const auto maker = sensor.hesai ? hesai::make(sensor.options) : velodyne::make(sensor.options);
  std::vector<std::string> remarks;
  return maker->decoder({packets.begin(), packets.begin() + 7}, remarks);
}

double azimuth_deg(const Point& p) { return std::atan2(-p.y, p.x) * 180.0 / M_PI; }

/// Greatest difference between the points' times and the motor's rotation, by one ring, whose laser
/// has one azimuth of its own.
double greatest_error_ms(const DecodedSweep& sweep) {
  const Point& first = sweep.points.front();
  double greatest_ms = 0.0;
  for (const Point& p : sweep.points) {
    if (p.ring != first.ring) continue;
    const double turned_ms = 1e-3 * kTurnUs * (azimuth_deg(p) - azimuth_deg(first)) / 360.0;
    const double after_ms = 1e-6 * (static_cast<double>(p.time_ns) - first.time_ns);
    const double error_ms = std::remainder(after_ms - turned_ms, 1e-3 * kTurnUs);
    greatest_ms = std::max(greatest_ms, std::abs(error_ms));
  }
  return greatest_ms;
}

TEST(ViewGap, OneSweepATurnInTimeAndNothingLost) {
  for (const Sensor& sensor : sensors()) {
    for (const double seam_deg : {0.0, 120.0}) {
      SCOPED_TRACE(std::string(sensor.name) + ", seam " + std::to_string(seam_deg));
      const std::vector<Bytes> packets =
          packed(sensor, fired_in_view(sensor, 2.0, kFirstDeg, kLastDeg));
      SweepAssembler assembler(decoder_of(sensor, packets), {.seam_azimuth_deg = seam_deg});
      const std::vector<DecodedSweep> sweeps = test::sweeps_of(assembler, packets);
      EXPECT_NEAR(static_cast<double>(sweeps.size()), 20.5, 1.0);
      test::expect_in_time_order(sweeps);
      for (std::size_t i = 6; i + 1 < sweeps.size(); ++i) {
        SCOPED_TRACE(i);
        EXPECT_TRUE(sweeps[i].complete);
        EXPECT_EQ(sweeps[i].packets_lost, 0U);
        EXPECT_NEAR(1e-6 * static_cast<double>(sweeps[i].stamp_ns - sweeps[i - 1].stamp_ns), 100.0,
                    1.0);
        EXPECT_LT(greatest_error_ms(sweeps[i]), 1.0);
      }
      const double gap_us = kTurnUs * (360.0 - kLastDeg + kFirstDeg) / 360.0;
      const double packet_us = sensor.group_us * static_cast<double>(sensor.groups);
      // Before the view's edges are known; between packets of one group they show by recurring.
      const double gaps = sensor.groups == 1 ? 4.0 : 1.0;
      EXPECT_LE(static_cast<double>(assembler.counts().lost), gaps * (gap_us / packet_us + 1.0));
    }
  }
}

TEST(ViewGap, AnOutageOfWholeTurnsBetweenItsEdgesIsLost) {
  const Sensor sensor = sensors()[1];
  ASSERT_EQ(sensor.groups, 1U);
  const std::vector<std::vector<Fired>> fired = fired_in_view(sensor, 2.0, kFirstDeg, kLastDeg);
  std::vector<std::vector<Fired>> kept;
  // The views of three turns, from one gap to another.
  std::copy_if(fired.begin(), fired.end(), std::back_inserter(kept), [](const auto& groups) {
    return groups.front().at_us < 2.05e6 || groups.front().at_us > 2.35e6;
  });
  const auto lost_of = [&](const std::vector<std::vector<Fired>>& groups) {
    const std::vector<Bytes> packets = packed(sensor, groups);
    SweepAssembler assembler(decoder_of(sensor, packets), {});
    test::sweeps_of(assembler, packets);
    return assembler.counts().lost;
  };
  EXPECT_GE(lost_of(kept), lost_of(fired) + fired.size() - kept.size());
}

/// The last packet's plan, and the time of a view's gap that its tail names.
std::pair<PacketPlan, std::int64_t> last_plan(const Sensor& sensor,
                                              const std::vector<std::vector<Fired>>& fired) {
  const std::vector<Bytes> packets = packed(sensor, fired);
  const std::unique_ptr<PacketDecoder> decoder = decoder_of(sensor, packets);
  std::pair<PacketPlan, std::int64_t> last;
  for (const Bytes& packet : packets) {
    const PacketTail tail = decoder->tail(packet);
    last = {decoder->plan(packet, tail.mode), tail.view_gap_ns};
  }
  return last;
}

TEST(ViewGap, ADamagedAzimuthInAFullViewIsNone) {
  for (const Sensor& sensor : sensors()) {
    if (sensor.groups == 1) continue;
    std::vector<std::vector<Fired>> fired = fired_in_view(sensor, 0.5, 0.0, 360.0);
    const PacketPlan sound = last_plan(sensor, fired).first;
    for (const std::size_t group : {std::size_t{0}, sensor.groups - 1}) {
      SCOPED_TRACE(std::string(sensor.name) + ", group " + std::to_string(group));
      std::vector<std::vector<Fired>> damaged = fired;
      int& azimuth_cdeg = damaged.back()[group].azimuth_cdeg;
      azimuth_cdeg = (azimuth_cdeg + 4000) % kTurnCdeg;
      const auto [plan, view_gap_ns] = last_plan(sensor, damaged);
      EXPECT_EQ(plan.gap_before_group, 0);
      EXPECT_EQ(view_gap_ns, 0);
      EXPECT_EQ(plan.duration_ns, sound.duration_ns);
      for (std::size_t g = 0; g < sensor.groups; ++g) {
        EXPECT_EQ(plan.group[g].offset_ns, sound.group[g].offset_ns);
      }
    }
  }
}

TEST(ViewGap, AViewRestrictedDuringTheRunIsKnownFromItsSecondGap) {
  for (const Sensor& sensor : sensors()) {
    if (sensor.groups == 1) continue;
    SCOPED_TRACE(sensor.name);
    std::vector<Fired> groups;
    for (const std::vector<Fired>& packet : fired_in_view(sensor, 2.0, 0.0, 360.0)) {
      for (const Fired& fired : packet) {
        const bool inside = fired.azimuth_cdeg >= 9000 && fired.azimuth_cdeg < 18000;
        if (fired.at_us < 1.5e6 || inside) groups.push_back(fired);
      }
    }
    std::vector<std::vector<Fired>> fired;
    for (std::size_t i = 0; i + sensor.groups <= groups.size(); i += sensor.groups) {
      fired.emplace_back(groups.begin() + static_cast<std::ptrdiff_t>(i),
                         groups.begin() + static_cast<std::ptrdiff_t>(i + sensor.groups));
    }
    const std::vector<Bytes> packets = packed(sensor, fired);
    SweepAssembler assembler(decoder_of(sensor, packets), {});
    const std::vector<DecodedSweep> sweeps = test::sweeps_of(assembler, packets);
    test::expect_in_time_order(sweeps);
    ASSERT_GT(sweeps.size(), 15U);
    for (std::size_t i = sweeps.size() - 8; i + 1 < sweeps.size(); ++i) {
      SCOPED_TRACE(i);
      EXPECT_TRUE(sweeps[i].complete);
      EXPECT_LT(greatest_error_ms(sweeps[i]), 1.0);
    }
  }
}

}  // namespace
}  // namespace zloam::driver
