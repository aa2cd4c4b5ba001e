#pragma once
// All points of one packet, for tests of a maker's decoder.

#include <gtest/gtest.h>

#include <span>
#include <vector>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver::test {

inline std::vector<Point> decode_all(PacketDecoder& decoder, std::span<const std::uint8_t> packet) {
  const PacketTail tail = decoder.tail(packet);
  EXPECT_EQ(tail.reject, Reject::kNone);
  const PacketPlan plan = decoder.plan(packet, tail.mode);
  std::vector<PlacedGroup> placed;
  for (int g = 0; g < plan.groups; ++g) {
    const Group& group = plan.group[static_cast<std::size_t>(g)];
    if (group.valid) placed.push_back({g, static_cast<std::uint32_t>(group.offset_ns), 0});
  }
  std::vector<Point> points(decoder.most_points_per_group(tail.mode) * placed.size() + 1);
  std::vector<std::uint16_t> columns(points.size());
  points.resize(decoder.decode_groups(plan, placed, points.data(), columns.data()));
  return points;
}

}  // namespace zloam::driver::test
