#include "driver/hesai/packet.hpp"

namespace zloam::driver::hesai {
namespace {

// Offsets within the tail.
constexpr std::size_t kModeAt = 10;
constexpr std::size_t kMinuteAt = 17;
constexpr std::size_t kSecondAt = 18;
constexpr std::size_t kMicrosecondAt = 19;

void read_mode(std::uint8_t mode_byte, Tail& tail) {
  switch (mode_byte) {
    case 0x33:
      tail.mode = ReturnMode::kStrongest;
      tail.first_only = true;
      break;
    case 0x37:
      tail.mode = ReturnMode::kStrongest;
      break;
    case 0x38:
      tail.mode = ReturnMode::kLast;
      break;
    case 0x39:
      tail.mode = ReturnMode::kDual;
      tail.pair = Pair::kLastAndStrongest;
      break;
    case 0x3B:
      tail.mode = ReturnMode::kDual;
      tail.pair = Pair::kLastAndFirst;
      break;
    case 0x3C:
      tail.mode = ReturnMode::kDual;
      tail.pair = Pair::kFirstAndStrongest;
      break;
    default:
      break;
  }
}

}  // namespace

std::optional<Header> header_of(std::span<const std::uint8_t> payload) {
  if (payload.size() < kHeaderBytes || payload[0] != 0xEE || payload[1] != 0xFF) {
    return std::nullopt;
  }
  Header header;
  header.protocol_major = payload[2];
  header.protocol_minor = payload[3];
  header.lasers = payload[6];
  header.blocks = payload[7];
  header.distance_unit_mm = payload[9];
  header.has_sequence = (payload[11] & 1) != 0;
  return header;
}

Tail tail_of(const std::uint8_t* payload, const Header& header) {
  const std::uint8_t* const at = payload + header.tail_at();
  Tail tail;
  read_mode(at[kModeAt], tail);
  constexpr std::uint32_t kSecondUs = 1'000'000;
  const std::uint32_t minute = at[kMinuteAt];
  const std::uint32_t second = at[kSecondAt];
  const std::uint32_t microsecond = read_u32(at + kMicrosecondAt);
  // The manual gives 1 000 000 as the last microsecond, and a minute may have a leap second.
  if (minute < 60 && second <= 60 && microsecond <= kSecondUs) {
    tail.toh_us = (60 * minute + second) * kSecondUs + microsecond;
  }
  return tail;
}

}  // namespace zloam::driver::hesai
