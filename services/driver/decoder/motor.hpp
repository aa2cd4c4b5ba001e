#pragma once
// The motor's advance from one firing group to the next, and the gap of a restricted field of view.

#include <array>
#include <cstdint>

#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver {

/// Keeps the last plausible motor speed of a stream.
class Motor {
 public:
  /// What a packet's stamp says the time of.
  enum class Stamp : std::uint8_t { kFirstGroup, kLastGroup };

  /// group_ns: from one firing group to the next.
  explicit Motor(double group_ns, Stamp stamp = Stamp::kFirstGroup);

  /// Sets the packet's advance; across a gap of the field of view also times and, of a packet whose
  /// first group is stamped, the duration.
  void measure(PacketPlan& plan);

  /// Time that a gap of the field of view within the packet takes; 0: there is none.
  std::int64_t view_gap_ns(const PacketPlan& plan) const;

 private:
  /// Azimuth differences between neighbouring good groups.
  struct Gaps {
    std::array<int, kMostGroups> cdeg;
    std::array<int, kMostGroups> group_after;
    int count = 0;
  };
  /// What a packet's gaps say: the usual ones, and the large one between them.
  struct Spread {
    int sum_cdeg = 0;
    int counted = 0;
    int large = 0;
    /// first group behind the last large gap
    int view_group = 0;
    int view_gap_cdeg = 0;
  };

  double even_advance_cdeg(const PacketPlan& plan) const;
  static Gaps gaps_of(const PacketPlan& plan);
  int typical_cdeg(const Gaps& gaps) const;
  Spread spread_of(const PacketPlan& plan) const;
  bool is_view_gap(const Spread& spread) const;
  void follow(const PacketPlan& plan, bool gap_within);
  bool plausible(double advance_cdeg) const {
    return advance_cdeg >= least_cdeg_ && advance_cdeg <= greatest_cdeg_;
  }
  void measure_uneven(PacketPlan& plan);
  void measure_by_packets(PacketPlan& plan);
  void keep(double advance_cdeg, PacketPlan& plan);
  std::int64_t passed_ns(int gap_cdeg) const;
  void pass_view_gap(PacketPlan& plan, const Spread& spread) const;

  double group_ns_;
  Stamp stamp_;
  double least_cdeg_;
  double greatest_cdeg_;
  double last_advance_cdeg_ = 0.0;
  double smooth_advance_cdeg_ = 0.0;
  /// rotation without a large gap, up to that of a full field of view
  int since_gap_cdeg_ = 0;
  /// last valid group of the packet before
  Group last_;
  /// of the packet before, for packets of one group only
  std::uint32_t last_toh_us_ = 0;
};

}  // namespace zloam::driver
