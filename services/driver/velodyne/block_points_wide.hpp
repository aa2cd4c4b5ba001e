#pragma once
// put_single for processors with wider registers: the same operations, one by one, and so the same
// results bit-exactly. Only if has_avx2() or has_avx512() returns true.

#include <span>

#include "driver/decoder/wide.hpp"
#include "driver/velodyne/block_points.hpp"

#if ZLOAM_WIDE

namespace zloam::driver::velodyne {

/// Eight cells at a time.
void put_single_avx2(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                     RawLimits limits, ReturnType type, PointSink& sink);

/// Sixteen cells at a time.
void put_single_avx512(std::span<const FiredBlock> blocks, const BeamTables& beams, int bank,
                       RawLimits limits, ReturnType type, PointSink& sink);

}  // namespace zloam::driver::velodyne

#endif
