#pragma once
// The data packet of Hesai's PandarXT sensors (PandarXT and PandarXT-16 user manuals, "Point Cloud
// Data Packet"): a pre-header that names the protocol, a header that names the sizes, eight blocks
// of one azimuth and all lasers, a tail with mode and time. Integers are little-endian.

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "driver/decoder/little_endian.hpp"
#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver::hesai {

inline constexpr int kBlocksPerPacket = 8;
/// Of the sensors that are decoded.
inline constexpr std::array<int, 2> kLaserCounts = {16, 32};
inline constexpr int kMostLasers = 32;
inline constexpr std::size_t kHeaderBytes = 12;
inline constexpr std::size_t kAzimuthBytes = 2;
/// distance, reflectivity, reserved
inline constexpr std::size_t kCellBytes = 4;
inline constexpr std::size_t kTailBytes = 24;
/// after the tail, if the header says so
inline constexpr std::size_t kSequenceBytes = 4;
/// From the firing of one block to that of the next (manual, appendix II).
inline constexpr std::int64_t kBlockNs = 50'000;
static_assert(kBlocksPerPacket <= kMostGroups);

/// Content of the first twelve bytes.
struct Header {
  int protocol_major = 0;
  int protocol_minor = 0;
  int lasers = 0;
  int blocks = 0;
  int distance_unit_mm = 0;
  bool has_sequence = false;

  /// One of the sensors decoded here.
  bool known() const {
    return protocol_major == 6 && protocol_minor == 1 && blocks == kBlocksPerPacket &&
           std::find(kLaserCounts.begin(), kLaserCounts.end(), lasers) != kLaserCounts.end() &&
           distance_unit_mm > 0;
  }
  std::size_t block_bytes() const {
    return kAzimuthBytes + kCellBytes * static_cast<std::size_t>(lasers);
  }
  std::size_t tail_at() const {
    return kHeaderBytes + block_bytes() * static_cast<std::size_t>(blocks);
  }
  std::size_t packet_bytes() const {
    return tail_at() + kTailBytes + (has_sequence ? kSequenceBytes : 0);
  }
};

inline std::string label_of(int lasers) { return "PandarXT-" + std::to_string(lasers); }

/// Nothing if the marks of a Hesai packet are missing, or the packet is too short.
std::optional<Header> header_of(std::span<const std::uint8_t> payload);

/// Content of the two blocks of a pair; not used with one return.
enum class Pair : std::uint8_t { kLastAndStrongest, kLastAndFirst, kFirstAndStrongest };

struct Tail {
  /// kUnknown: a mode in no manual
  ReturnMode mode = ReturnMode::kUnknown;
  /// of one return: the first one, which is neither the strongest nor the last
  bool first_only = false;
  Pair pair = Pair::kLastAndStrongest;
  /// time of the firing command of the last block, since the top of the hour; nothing: not
  /// plausible
  std::optional<std::uint32_t> toh_us;
};

/// Reads the tail of a complete packet.
Tail tail_of(const std::uint8_t* payload, const Header& header);

}  // namespace zloam::driver::hesai
