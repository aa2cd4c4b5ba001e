#include "driver/velodyne/position.hpp"

#include <algorithm>

#include "driver/velodyne/packet.hpp"

namespace zloam::driver::velodyne {
namespace {

constexpr std::size_t kInertialAt = 14;
constexpr std::size_t kPositionTimeAt = 198;
constexpr std::size_t kPpsAt = 202;
constexpr std::size_t kSentenceAt = 206;
constexpr double kGyroDps = 0.09766;
constexpr double kTemperatureC = 0.1453;
constexpr double kAccelG = 0.001221;

/// The low 12 bits as a two's complement number.
int read_12_bits(const std::uint8_t* at) {
  const int value = (at[0] | at[1] << 8) & 0xFFF;
  return value >= 0x800 ? value - 0x1000 : value;
}

}  // namespace

std::optional<InertialPositionPacket> parse_position(std::span<const std::uint8_t> payload) {
  if (payload.size() != kPositionPacketBytes) return std::nullopt;
  InertialPositionPacket packet;
  for (std::size_t i = 0; i < packet.inertial.size(); ++i) {
    const std::uint8_t* at = payload.data() + kInertialAt + 8 * i;
    packet.inertial[i] = {kGyroDps * read_12_bits(at), 25.0 + kTemperatureC * read_12_bits(at + 2),
                          kAccelG * read_12_bits(at + 4), kAccelG * read_12_bits(at + 6)};
  }
  for (unsigned i = 0; i < 4; ++i) {
    packet.toh_us |= static_cast<std::uint32_t>(payload[kPositionTimeAt + i]) << (8 * i);
  }
  packet.pps = static_cast<Pps>(std::min<std::uint8_t>(payload[kPpsAt], 3));
  for (const std::uint8_t byte : payload.subspan(kSentenceAt)) {
    if (byte == 0 || byte == '\r' || byte == '\n') break;
    // A sentence consists of printable characters only; others are replaced.
    packet.nmea.push_back(byte >= 0x20 && byte < 0x7F ? static_cast<char>(byte) : '?');
  }
  return packet;
}

}  // namespace zloam::driver::velodyne
