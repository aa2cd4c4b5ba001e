#pragma once
// Converts cells of a block to points.

#include <cstdint>
#include <span>

#include "common/geometry/point.hpp"
#include "driver/decoder/raw_limits.hpp"
#include "driver/velodyne/beams.hpp"
#include "driver/velodyne/packet.hpp"

namespace zloam::driver::velodyne {

/// Values common to all points of a block.
struct BlockFrame {
  float cos_azimuth;
  float sin_azimuth;
  float unit_m;
  /// of the group's first firing
  std::uint32_t time_ns;
  std::uint16_t column;
};

/// Where the next points and their columns are written. There must be room for all cells of the
/// blocks, and for one more point.
struct PointSink {
  Point* points;
  std::uint16_t* columns;
  std::size_t count = 0;
};

/// A block, and values common to its points.
struct FiredBlock {
  const std::uint8_t* block;
  BlockFrame frame;
};

/// Writes the returns of blocks of one bank, one block after the other.
void put_single(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                RawLimits limits, ReturnType type, PointSink& sink);

/// The same with four lanes on any processor; put_single must agree with it bit-exactly.
void put_single_portable(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                         RawLimits limits, ReturnType type, PointSink& sink);

/// Writes the returns of a pair of blocks; last: the even one, strongest: the odd one. Either may
/// be missing (nullptr). If the strongest return is also the last one, the odd block holds the
/// second strongest, and the packet does not distinguish the two cases (VLP-16 manual p. 57).
void put_dual(const std::uint8_t* last, const std::uint8_t* strongest, const BeamTables& beams,
              int bank, const BlockFrame& frame, RawLimits limits, DualReturns policy,
              PointSink& sink);

}  // namespace zloam::driver::velodyne
