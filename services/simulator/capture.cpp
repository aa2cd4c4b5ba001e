#include "simulator/capture.hpp"

#include <array>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "simulator/calendar.hpp"

namespace zloam::simulator {
namespace {

using Bytes = std::vector<std::uint8_t>;

constexpr std::size_t kEthernetBytes = 14;
constexpr std::size_t kIpBytes = 20;
constexpr std::size_t kUdpBytes = 8;
constexpr std::uint32_t kSensorAddress = 0xC0A801C9;  // 192.168.1.201
constexpr std::uint32_t kBroadcast = 0xFFFFFFFF;

void little(Bytes& out, std::uint64_t value, int size) {
  for (int i = 0; i < size; ++i) {
    out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

void big(Bytes& out, std::uint64_t value, int size) {
  for (int i = size - 1; i >= 0; --i) {
    out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  }
}

// RFC 791: complement of the one's complement sum of the header's 16-bit words.
std::uint16_t ip_checksum(std::span<const std::uint8_t> header) {
  std::uint32_t sum = 0;
  for (std::size_t i = 0; i + 1 < header.size(); i += 2) {
    sum += static_cast<std::uint32_t>(header[i] << 8 | header[i + 1]);
  }
  while (sum > 0xFFFF) {
    sum = (sum & 0xFFFF) + (sum >> 16);
  }
  return static_cast<std::uint16_t>(~sum);
}

void append_frame(const Datagram& datagram, Bytes& out) {
  const std::size_t udp_length = kUdpBytes + datagram.payload.size();
  big(out, 0xFFFFFFFFFFFF, 6);  // broadcast
  big(out, 0x607688000001, 6);
  big(out, 0x0800, 2);  // IPv4
  const std::size_t ip = out.size();
  big(out, 0x4500, 2);
  big(out, kIpBytes + udp_length, 2);
  big(out, 0, 2);       // identification
  big(out, 0x4000, 2);  // flag "don't fragment"
  big(out, 0xFF11, 2);  // time to live, UDP
  big(out, 0, 2);       // checksum, below
  big(out, kSensorAddress, 4);
  big(out, kBroadcast, 4);
  const std::uint16_t checksum = ip_checksum(std::span(out).subspan(ip, kIpBytes));
  out[ip + 10] = static_cast<std::uint8_t>(checksum >> 8);
  out[ip + 11] = static_cast<std::uint8_t>(checksum);
  big(out, datagram.port, 2);
  big(out, datagram.port, 2);
  big(out, udp_length, 2);
  big(out, 0, 2);  // no UDP checksum, like the sensor
  out.insert(out.end(), datagram.payload.begin(), datagram.payload.end());
}

}  // namespace

std::vector<Datagram> datagrams(const Sensor& sensor, std::int64_t first,
                                std::span<const DataPacket> packets) {
  std::vector<Datagram> out;
  const std::int64_t epoch_ns = sensor.config().epoch_ns;
  for (std::size_t i = 0; i < packets.size(); ++i) {
    const std::int64_t index = first + static_cast<std::int64_t>(i);
    const std::int64_t sent_ns =
        epoch_ns + packets[i].time_ns + sensor.packet_period_ns() + kSendDelayNs;
    const vlp16::DataBytes& data = packets[i].bytes;
    out.push_back({sent_ns, vlp16::kDataPort, index, {data.begin(), data.end()}});
    if ((index + 1) % vlp16::kDataPerPosition == 0) {
      const vlp16::PositionBytes position = sensor.position_packet(index);
      out.push_back({sent_ns + kSendDelayNs,
                     vlp16::kPositionPort,
                     index,
                     {position.begin(), position.end()}});
    }
  }
  return out;
}

std::vector<std::uint8_t> pcap_header(bool nanoseconds) {
  Bytes out;
  little(out, nanoseconds ? 0xA1B23C4D : 0xA1B2C3D4, 4);
  little(out, 2, 2);  // version 2.4
  little(out, 4, 2);
  little(out, 0, 8);        // time zone, accuracy
  little(out, 0x40000, 4);  // longest record
  little(out, 1, 4);        // Ethernet
  return out;
}

void append_pcap_record(const Datagram& datagram, bool nanoseconds,
                        std::vector<std::uint8_t>& out) {
  constexpr std::int64_t kSecondNs = 1'000'000'000;
  const std::int64_t fraction = datagram.sent_ns % kSecondNs;
  const std::size_t length = kEthernetBytes + kIpBytes + kUdpBytes + datagram.payload.size();
  little(out, static_cast<std::uint64_t>(datagram.sent_ns / kSecondNs), 4);
  little(out, static_cast<std::uint64_t>(nanoseconds ? fraction : fraction / 1000), 4);
  little(out, length, 4);
  little(out, length, 4);
  append_frame(datagram, out);
}

std::string tum_line(std::int64_t unix_ns, const Pose& pose) {
  const Eigen::Quaterniond q = Eigen::Quaterniond(pose.linear()).normalized();
  const Eigen::Vector3d p = pose.translation();
  std::array<char, 256> text;
  // The time is printed from integers: a double resolves today's Unix time only to 240 ns.
  const int length = std::snprintf(text.data(), text.size(),
                                   "%lld.%09lld %.9f %.9f %.9f %.12f %.12f %.12f %.12f\n",
                                   static_cast<long long>(unix_ns / 1'000'000'000),
                                   static_cast<long long>(unix_ns % 1'000'000'000), p.x(), p.y(),
                                   p.z(), q.x(), q.y(), q.z(), q.w());
  return {text.data(), static_cast<std::size_t>(length)};
}

std::int64_t parse_utc(const std::string& text) {
  Date date{};
  int hour = 0;
  int minute = 0;
  double second = 0.0;
  int used = 0;
  const int fields = std::sscanf(text.c_str(), "%d-%d-%dT%d:%d:%lf%n", &date.year, &date.month,
                                 &date.day, &hour, &minute, &second, &used);
  const std::string rest = fields == 6 ? text.substr(static_cast<std::size_t>(used)) : "";
  const bool clock =
      hour >= 0 && hour < 24 && minute >= 0 && minute < 60 && second >= 0.0 && second < 60.0;
  if (fields != 6 || !(rest.empty() || rest == "Z") || !is_date(date) || date.year < 1970 ||
      !clock) {
    throw std::invalid_argument("'" + text + "' is not a time like 2024-01-01T00:00:10");
  }
  const int minutes = hour * 60 + minute;
  const std::int64_t whole_s = days_from_date(date) * 86'400 + std::int64_t{60} * minutes;
  return whole_s * 1'000'000'000 + std::llround(second * 1e6) * 1000;
}

}  // namespace zloam::simulator
