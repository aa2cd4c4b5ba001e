#pragma once
// For column_points.cpp only.

#include "driver/decoder/wide.hpp"
#include "driver/ouster/column_points.hpp"

namespace zloam::driver::ouster {

/// The type's bits beside the ring, as in a point.
inline std::uint32_t bits_of(ReturnType type) { return static_cast<std::uint32_t>(type) << 16; }

#if ZLOAM_WIDE
/// Sixteen lanes at a time; the number of lanes must be a multiple of 16.
std::size_t put_columns_avx512(std::span<const MeasuredColumn> columns, const ColumnReader& reader,
                               Point* out, std::uint16_t* out_columns);
#endif

}  // namespace zloam::driver::ouster
