#pragma once
// The data packet of the Velodyne family: 1206 bytes of UDP payload, 12 blocks of 32 cells, a time
// stamp in microseconds since the top of the hour, return mode and product byte (VLP-16 manual
// 63-9243, section 9.3).

#include <cstddef>
#include <cstdint>

#include "driver/decoder/little_endian.hpp"
#include "driver/decoder/packet_decoder.hpp"

namespace zloam::driver::velodyne {

inline constexpr std::size_t kDataPacketBytes = 1206;
inline constexpr std::size_t kPositionPacketBytes = 512;
inline constexpr int kBlocksPerPacket = 12;
inline constexpr std::size_t kBlockBytes = 100;
/// Offset of a data packet's time stamp.
inline constexpr std::size_t kTimeAt = 1200;
inline constexpr int kCellsPerBlock = 32;
static_assert(kBlocksPerPacket <= kMostGroups);
/// Cells of a packet: the most points it can give.
inline constexpr std::size_t kMaxPointsPerPacket = 384;

/// Bank of lasers of a block flag; -1 for none.
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

}  // namespace zloam::driver::velodyne
