#pragma once
// Packets that a live sensor sent while its driver was down. The driver that was started again
// can't know what the one before it had; who hears both runs can, by the sensor's own clock.

#include <cstdint>

namespace zloam::registration {

/// What a sweep tells of the packets it was made of.
struct PacketSpan {
  /// sensor's own time of the first and the last packet, us since the top of its hour
  std::uint32_t first_toh_us = 0;
  std::uint32_t last_toh_us = 0;
  /// from one packet's stamp to the next one's; 0: unknown
  std::uint32_t period_ns = 0;
  /// receiver's clock at the last packet, ns: tells hours apart
  std::int64_t last_received_ns = 0;
};

/// Packets between the last one of a run's last sweep and the first one of the next run's first
/// sweep, where the sensor sent without a break and its clock was not set; 0 where a period is
/// unknown.
std::int64_t packets_between(const PacketSpan& before, const PacketSpan& after);

}  // namespace zloam::registration
