#include "driver/io/closed_ports.hpp"

#include <fstream>
#include <sstream>
#include <string>

namespace zloam::driver {
namespace {

/// The next line that begins with "Udp:", without this beginning.
std::istringstream next_udp_line(std::istream& snmp) {
  constexpr std::string_view kBegin = "Udp:";
  for (std::string line; std::getline(snmp, line);) {
    if (line.starts_with(kBegin)) return std::istringstream(line.substr(kBegin.size()));
  }
  return {};
}

}  // namespace

std::uint64_t datagrams_to_closed_ports(std::istream& snmp) {
  std::istringstream names = next_udp_line(snmp);
  std::istringstream values = next_udp_line(snmp);
  std::uint64_t sum = 0;
  std::string name;
  for (std::uint64_t value = 0; names >> name && values >> value;) {
    if (name == "NoPorts" || name == "IgnoredMulti") sum += value;
  }
  return sum;
}

std::uint64_t datagrams_to_closed_ports() {
  std::ifstream snmp("/proc/net/snmp");
  return datagrams_to_closed_ports(snmp);
}

}  // namespace zloam::driver
