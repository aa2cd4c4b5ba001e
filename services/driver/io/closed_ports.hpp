#pragma once
// Counts datagrams that no program receives, as from a sensor that sends to another port.

#include <cstdint>
#include <istream>

namespace zloam::driver {

/// Sum of NoPorts and IgnoredMulti (broadcasts, groups) of the line Udp in the kernel's
/// /proc/net/snmp: two lines of that name, the fields' names and their values. 0: neither is there.
std::uint64_t datagrams_to_closed_ports(std::istream& snmp);

/// Of this host (network namespace) since it was started.
std::uint64_t datagrams_to_closed_ports();

}  // namespace zloam::driver
