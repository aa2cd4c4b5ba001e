#pragma once
// All points of one packet, for tests of the decoder.

#include <gtest/gtest.h>

#include <vector>

#include "driver/velodyne/decoder.hpp"
#include "driver/velodyne/test_packets.hpp"

namespace zloam::driver::velodyne::test {

inline std::vector<Point> decode_all(Decoder& decoder, const Payload& payload) {
  const PacketTail tail = decoder.tail(payload);
  EXPECT_EQ(tail.reject, Reject::kNone);
  const PacketPlan plan = decoder.plan(payload, tail.mode);
  std::vector<Point> points;
  std::vector<Point> out(decoder.most_points_per_group(ReturnMode::kDual) + 1);
  std::vector<std::uint16_t> columns(out.size());
  for (int g = 0; g < plan.groups; ++g) {
    if (!plan.group[g].valid) continue;
    const PlacedGroup placed{g, static_cast<std::uint32_t>(plan.group[g].offset_ns), 0};
    const std::size_t count = decoder.decode_groups(plan, {&placed, 1}, out.data(), columns.data());
    points.insert(points.end(), out.begin(), out.begin() + static_cast<std::ptrdiff_t>(count));
  }
  return points;
}

}  // namespace zloam::driver::velodyne::test
