#include "driver/io/link_layer.hpp"

#include <algorithm>
#include <array>

namespace zloam::driver {
namespace {

constexpr int kLoopback = 0;
constexpr int kEthernet = 1;
constexpr int kRawIp = 12;
constexpr int kRawIpFile = 101;
constexpr int kOpenBsdLoopback = 108;
constexpr int kCooked1 = 113;
constexpr int kIpv4Only = 228;
constexpr int kCooked2 = 276;
constexpr std::array kKnown = {kLoopback,        kEthernet, kRawIp,    kRawIpFile,
                               kOpenBsdLoopback, kCooked1,  kIpv4Only, kCooked2};

constexpr unsigned kTypeIpv4 = 0x0800;
constexpr unsigned kTypeIpv6 = 0x86DD;
constexpr unsigned kProtocolUdp = 17;
constexpr std::size_t kUdpHeader = 8;
constexpr unsigned kMoreFragments = 0x2000;
constexpr unsigned kFragmentOffset = 0x1FFF;

using Bytes = std::span<const std::uint8_t>;

unsigned big16(Bytes bytes, std::size_t at) {
  return static_cast<unsigned>(bytes[at] << 8 | bytes[at + 1]);
}

bool is_vlan(unsigned type) { return type == 0x8100 || type == 0x88A8 || type == 0x9100; }

/// Skips VLAN tags. The type field is at type_at, the payload at data_at. Empty if the frame is
/// cut.
Bytes behind_type(Bytes frame, std::size_t type_at, std::size_t data_at, unsigned& type) {
  if (frame.size() < data_at) return {};
  type = big16(frame, type_at);
  while (is_vlan(type)) {
    if (frame.size() < data_at + 4) return {};
    type = big16(frame, data_at + 2);
    data_at += 4;
  }
  return frame.subspan(data_at);
}

/// Of an address family, whose number is in a loopback frame's first or fourth byte, in the byte
/// order of the capturing machine. That of IPv6 differs between operating systems.
unsigned type_of_family(int family) {
  constexpr int kIpv4 = 2;
  constexpr std::array kIpv6 = {10, 24, 28, 30};
  if (family == kIpv4) return kTypeIpv4;
  return std::find(kIpv6.begin(), kIpv6.end(), family) == kIpv6.end() ? 0 : kTypeIpv6;
}

/// Returns the network layer of the frame and sets its type; empty if the frame is cut.
Bytes network_layer(int link_type, Bytes frame, unsigned& type) {
  switch (link_type) {
    case kEthernet:
      return behind_type(frame, 12, 14, type);
    case kCooked1:
      return behind_type(frame, 14, 16, type);
    case kCooked2:
      return behind_type(frame, 0, 20, type);
    case kLoopback:
    case kOpenBsdLoopback:
      if (frame.size() < 4) return {};
      type = type_of_family(frame[0] | frame[3]);
      return frame.subspan(4);
    default:
      type = !frame.empty() && frame[0] >> 4 == 6 ? kTypeIpv6 : kTypeIpv4;
      return frame;
  }
}

FrameKind parse_udp(Bytes udp, Datagram& datagram) {
  if (udp.size() < kUdpHeader) return FrameKind::kCut;
  const std::size_t length = big16(udp, 4);
  if (length < kUdpHeader) return FrameKind::kOther;
  if (udp.size() < length) return FrameKind::kCut;
  datagram.payload = udp.subspan(kUdpHeader, length - kUdpHeader);
  datagram.port = static_cast<std::uint16_t>(big16(udp, 2));
  return FrameKind::kUdp;
}

}  // namespace

bool link_type_known(int link_type) {
  return std::find(kKnown.begin(), kKnown.end(), link_type) != kKnown.end();
}

FrameKind parse_frame(int link_type, Bytes frame, IpFragments& fragments, Datagram& datagram) {
  unsigned type = 0;
  const Bytes ip = network_layer(link_type, frame, type);
  if (type == kTypeIpv6) return FrameKind::kIpv6;
  if (type != kTypeIpv4) return FrameKind::kOther;
  if (ip.size() < 20) return FrameKind::kCut;
  if (ip[0] >> 4 != 4 || ip[9] != kProtocolUdp) return FrameKind::kOther;
  const std::size_t header = std::size_t{4} * (ip[0] & 0x0FU);
  if (header < 20) return FrameKind::kOther;
  if (ip.size() < header) return FrameKind::kCut;
  datagram.sender = static_cast<std::uint32_t>(big16(ip, 12) << 16 | big16(ip, 14));
  const unsigned fragment = big16(ip, 6);
  if ((fragment & (kMoreFragments | kFragmentOffset)) == 0) {
    return parse_udp(ip.subspan(header), datagram);
  }
  // IPv4's own length excludes Ethernet's padding.
  const std::size_t length = big16(ip, 2);
  if (length < header || ip.size() < length) return FrameKind::kCut;
  const auto receiver = static_cast<std::uint32_t>(big16(ip, 16) << 16 | big16(ip, 18));
  const Bytes whole =
      fragments.add({datagram.sender, receiver, static_cast<std::uint16_t>(big16(ip, 4))},
                    datagram.received_ns, std::size_t{8} * (fragment & kFragmentOffset),
                    (fragment & kMoreFragments) != 0, ip.subspan(header, length - header));
  return whole.empty() ? FrameKind::kFragment : parse_udp(whole, datagram);
}

}  // namespace zloam::driver
