#pragma once
// Counts the packets that a live sensor sent while its driver was down. The restarted driver does
// not know its predecessor's last packet; a receiver of both runs does, by the sensor's own clock.

#include <cstdint>

namespace zloam::registration {

/// The packets that a sweep was made of.
struct PacketSpan {
  /// sensor's own time of the first and the last packet, us since the top of its hour
  std::uint32_t first_toh_us = 0;
  std::uint32_t last_toh_us = 0;
  /// from one packet's stamp to the next one's; 0: unknown
  std::uint32_t period_ns = 0;
  /// receiver's clock at the last packet, ns: distinguishes hours
  std::int64_t last_received_ns = 0;
};

/// Packets between the last packet of a run's last sweep and the first packet of the next run's
/// first sweep, if the sensor sent without a break and its clock was not set; 0 if a period is
/// unknown.
std::int64_t packets_between(const PacketSpan& before, const PacketSpan& after);

}  // namespace zloam::registration
