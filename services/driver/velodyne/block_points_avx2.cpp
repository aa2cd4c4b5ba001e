#include "driver/velodyne/block_points_wide.hpp"

#if ZLOAM_WIDE

#include <immintrin.h>

#include "driver/velodyne/block_writer.hpp"

#define ZLOAM_AVX2 __attribute__((target("avx2"), always_inline)) inline

namespace zloam::driver::velodyne {
namespace {

constexpr int kLanes = 8;

ZLOAM_AVX2 __m256i load_eight(const std::uint32_t* at) {
  return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at));
}

/// Eight cells in eight lanes; reads four bytes beyond the last cell.
struct Wide {
  __m256 points[4];
  /// time, then ring and type: first of points 0, 1, 4, 5, then of points 2, 3, 6, 7
  __m256i rests[2];
  unsigned kept;
};

ZLOAM_AVX2 Wide read_wide(const std::uint8_t* cells, const BeamTables& beams, std::size_t channel,
                          const BlockFrame& frame, RawLimits limits, __m256i common_time_ns,
                          __m256i types) {
  const __m256i raw_bytes = _mm256_broadcastsi128_si256(
      _mm_setr_epi8(0, 1, -1, -1, 3, 4, -1, -1, 6, 7, -1, -1, 9, 10, -1, -1));
  const __m256i intensity_bytes = _mm256_broadcastsi128_si256(
      _mm_setr_epi8(2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1, -1, 11, -1, -1, -1));
  const auto load_cells = [](const std::uint8_t* at) {
    return _mm_loadu_si128(reinterpret_cast<const __m128i*>(at));
  };
  const __m256i packed =
      _mm256_set_m128i(load_cells(cells + kLanes / 2 * kCellBytes), load_cells(cells));
  const __m256i raw = _mm256_shuffle_epi8(packed, raw_bytes);
  const auto lowest = static_cast<int>(limits.lowest);
  const __m256i is_kept = _mm256_and_si256(
      _mm256_cmpgt_epi32(raw, _mm256_set1_epi32(lowest - 1)),
      _mm256_cmpgt_epi32(_mm256_set1_epi32(lowest + static_cast<int>(limits.span) + 1), raw));
  const __m256 intensity = _mm256_cvtepi32_ps(_mm256_shuffle_epi8(packed, intensity_bytes));
  const __m256 range_m = _mm256_cvtepi32_ps(raw) * frame.unit_m;
  const __m256 along = _mm256_loadu_ps(&beams.along[channel]);
  const __m256 across = _mm256_loadu_ps(&beams.across[channel]);
  const __m256 x = range_m * (along * frame.cos_azimuth - across * frame.sin_azimuth);
  const __m256 y = -range_m * (along * frame.sin_azimuth + across * frame.cos_azimuth);
  const __m256 z =
      range_m * _mm256_loadu_ps(&beams.up[channel]) + _mm256_loadu_ps(&beams.height_m[channel]);
  const __m256 xy_low = _mm256_unpacklo_ps(x, y);
  const __m256 xy_high = _mm256_unpackhi_ps(x, y);
  const __m256 zi_low = _mm256_unpacklo_ps(z, intensity);
  const __m256 zi_high = _mm256_unpackhi_ps(z, intensity);
  const __m256i time_ns = _mm256_add_epi32(load_eight(&beams.time_ns[channel]), common_time_ns);
  const __m256i ring_and_type = _mm256_or_si256(load_eight(&beams.ring[channel]), types);
  return {{_mm256_shuffle_ps(xy_low, zi_low, 0x44), _mm256_shuffle_ps(xy_low, zi_low, 0xEE),
           _mm256_shuffle_ps(xy_high, zi_high, 0x44), _mm256_shuffle_ps(xy_high, zi_high, 0xEE)},
          {_mm256_unpacklo_epi32(time_ns, ring_and_type),
           _mm256_unpackhi_epi32(time_ns, ring_and_type)},
          static_cast<unsigned>(_mm256_movemask_ps(_mm256_castsi256_ps(is_kept)))};
}

ZLOAM_AVX2 void put_pair(Writer& writer, __m128 first, __m128 second, __m128i rests,
                         unsigned kept) {
  _mm_storeu_ps(reinterpret_cast<float*>(writer.at()), first);
  _mm_storel_epi64(reinterpret_cast<__m128i*>(writer.at() + kHalf), rests);
  writer.count += kept & 1;
  _mm_storeu_ps(reinterpret_cast<float*>(writer.at()), second);
  _mm_storeh_pd(reinterpret_cast<double*>(writer.at() + kHalf), _mm_castsi128_pd(rests));
  writer.count += kept >> 1 & 1;
}

ZLOAM_AVX2 void put_block(const FiredBlock& fired, const BeamTables& beams, int bank,
                          RawLimits limits, ReturnType type, Writer& writer) {
  const auto& [block, frame] = fired;
  const __m256i time_ns = _mm256_set1_epi32(static_cast<int>(frame.time_ns));
  const __m256i types = _mm256_set1_epi32(static_cast<int>(type_bits(type)));
  for (int c = 0; c < kCellsPerBlock; c += kLanes) {
    const std::size_t channel = channel_of(bank, c);
    if (c % kChannelsPerColumn == 0) writer.fill_columns(column_of(frame, beams, channel), 1);
    const std::uint8_t* cells =
        block + kFlagAndAzimuthBytes + kCellBytes * static_cast<std::size_t>(c);
    const Wide wide = read_wide(cells, beams, channel, frame, limits, time_ns, types);
    // Lanes 0 to 3 are in the lower half of each register, lanes 4 to 7 in the upper half.
    const auto& [points, rests, kept] = wide;
    put_pair(writer, _mm256_castps256_ps128(points[0]), _mm256_castps256_ps128(points[1]),
             _mm256_castsi256_si128(rests[0]), kept);
    put_pair(writer, _mm256_castps256_ps128(points[2]), _mm256_castps256_ps128(points[3]),
             _mm256_castsi256_si128(rests[1]), kept >> 2);
    put_pair(writer, _mm256_extractf128_ps(points[0], 1), _mm256_extractf128_ps(points[1], 1),
             _mm256_extracti128_si256(rests[0], 1), kept >> 4);
    put_pair(writer, _mm256_extractf128_ps(points[2], 1), _mm256_extractf128_ps(points[3], 1),
             _mm256_extracti128_si256(rests[1], 1), kept >> 6);
  }
}

}  // namespace

__attribute__((target("avx2"))) void put_single_avx2(std::span<const FiredBlock> blocks,
                                                     const BeamTables& beams, int bank,
                                                     RawLimits limits, ReturnType type,
                                                     PointSink& sink) {
  Writer writer(sink);
  for (const FiredBlock& fired : blocks) put_block(fired, beams, bank, limits, type, writer);
  sink.count = writer.count;
}

}  // namespace zloam::driver::velodyne

#endif
