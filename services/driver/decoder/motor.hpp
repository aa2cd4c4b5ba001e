#pragma once
// The motor's advance from one firing group to the next, and the gap of a restricted field of view.

#include <array>
#include <cstdint>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// Keeps the last plausible motor speed of a stream.
class Motor {
 public:
  /// From one firing group to the next.
  explicit Motor(double group_ns);

  /// Sets the packet's advance; across a gap of the field of view also times and duration.
  void measure(PacketPlan& plan);

 private:
  /// Azimuth differences between neighbouring good groups.
  struct Gaps {
    std::array<int, kMostGroups> cdeg;
    std::array<int, kMostGroups> group_after;
    int count = 0;
  };

  bool measure_even(PacketPlan& plan);
  static Gaps gaps_of(const PacketPlan& plan);
  bool plausible(double advance_cdeg) const {
    return advance_cdeg >= least_cdeg_ && advance_cdeg <= greatest_cdeg_;
  }
  void measure_uneven(PacketPlan& plan);
  void measure_by_packets(PacketPlan& plan);
  void keep(double advance_cdeg, PacketPlan& plan);
  void pass_view_gap(PacketPlan& plan, int first_group, int gap_cdeg) const;

  double group_ns_;
  double least_cdeg_;
  double greatest_cdeg_;
  double last_advance_cdeg_ = 0.0;
  double smooth_advance_cdeg_ = 0.0;
  // of the packet before, for packets of one group only
  int last_azimuth_cdeg_ = -1;
  std::uint32_t last_toh_us_ = 0;
};

}  // namespace zloam::driver
