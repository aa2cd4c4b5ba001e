#pragma once
// The data packet of the Velodyne family: 1206 bytes of UDP payload, 12 blocks of 32 cells, a time
// stamp in microseconds since the top of the hour, return mode and product byte (VLP-16 manual
// 63-9243, section 9.3).

#include <array>
#include <cstddef>
#include <cstdint>

namespace zloam::driver {

inline constexpr std::size_t kDataPacketBytes = 1206;
inline constexpr std::size_t kPositionPacketBytes = 512;
inline constexpr int kBlocksPerPacket = 12;
inline constexpr std::size_t kBlockBytes = 100;
inline constexpr int kCellsPerBlock = 32;
inline constexpr int kTurnCdeg = 36000;
inline constexpr int kHalfTurnCdeg = kTurnCdeg / 2;
/// Cells of a packet, and so the most points it can give.
inline constexpr std::size_t kMaxPointsPerPacket = 384;

enum class ReturnMode : std::uint8_t { kUnknown = 0, kStrongest = 1, kLast = 2, kDual = 3 };

/// Why a packet, or a block of it, gave no points.
enum class Reject : std::uint8_t {
  kNone,
  kShort,          // a data packet cut off
  kForeign,        // a length that is no packet of this family
  kUnknownModel,   // product byte of no model known here, and none forced
  kModelMismatch,  // product byte of another model than the stream began with
  kUnknownMode,    // return mode byte that is none of 0x37, 0x38, 0x39
  kBadTime,        // time stamp beyond the hour and its tolerance
};

/// What a look at the tail of a packet tells; cheap, for ordering packets before they are decoded.
struct PacketTail {
  Reject reject = Reject::kNone;
  std::uint32_t toh_us = 0;
  ReturnMode mode = ReturnMode::kUnknown;
};

/// One firing group: a block, a pair of blocks (dual return), or the banks of a 128-beam model.
struct Group {
  bool valid = false;
  int azimuth_cdeg = 0;
  /// firing of the group's first channel after the packet's stamp
  std::int64_t offset_ns = 0;
};

/// A packet made ready for decoding.
struct PacketPlan {
  const std::uint8_t* payload = nullptr;
  std::uint32_t toh_us = 0;
  ReturnMode mode = ReturnMode::kUnknown;
  int groups = 0;
  std::array<Group, kBlocksPerPacket> group;
  /// azimuth advance in one group, 0.01 degrees; 0 when unknown
  double advance_cdeg = 0.0;
  /// from this packet's stamp to the next one's
  std::int64_t duration_ns = 0;
  int bad_blocks = 0;
  /// first group after a restricted field of view's gap, or 0; the gap's time is in the offsets
  int gap_before_group = 0;
};

inline std::uint16_t read_u16(const std::uint8_t* at) {
  return static_cast<std::uint16_t>(at[0] | (at[1] << 8));
}

inline std::uint32_t read_u32(const std::uint8_t* at) {
  return read_u16(at) | (static_cast<std::uint32_t>(read_u16(at + 2)) << 16);
}

/// Bank of lasers a block flag stands for; -1 for none.
inline int bank_of(const std::uint8_t* block) {
  switch (read_u16(block)) {
    case 0xEEFF:
      return 0;
    case 0xDDFF:
      return 1;
    case 0xCCFF:
      return 2;
    case 0xBBFF:
      return 3;
    default:
      return -1;
  }
}

}  // namespace zloam::driver
