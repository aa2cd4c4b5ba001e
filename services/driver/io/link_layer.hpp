#pragma once
// From a captured frame to the UDP datagram in it.

#include <cstdint>
#include <span>

#include "driver/io/ip_fragments.hpp"
#include "driver/io/packet_source.hpp"

namespace zloam::driver {

enum class FrameKind : std::uint8_t {
  kUdp,
  kOther,     // not IP, or not UDP
  kIpv6,      // is not read
  kFragment,  // part of a datagram that is not complete yet
  kCut,       // the capture holds less of the frame than its headers say
};

/// Link types as pcap numbers them: Ethernet 1, cooked 113 and 276, raw IP 12, 101 and 228,
/// loopback 0 and 108.
bool link_type_known(int link_type);

/// Sets payload, port and sender; received_ns is the frame's already. The payload lies in the
/// frame, or in the last datagram completed by fragments.
FrameKind parse_frame(int link_type, std::span<const std::uint8_t> frame, IpFragments& fragments,
                      Datagram& datagram);

}  // namespace zloam::driver
