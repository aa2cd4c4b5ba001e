#include "driver/velodyne/block_points_wide.hpp"

#if ZLOAM_WIDE

#include <immintrin.h>

#include "driver/velodyne/block_writer.hpp"

#define ZLOAM_AVX512 __attribute__((target("avx512f,avx512bw,avx512vbmi"), always_inline)) inline

namespace zloam::driver {
namespace {

constexpr int kLanes = 16;

/// Sixteen cells: those that are kept are moved to the front, in order.
struct Cells {
  __m512 x, y, z, intensity;
  __m512i time_ns, ring_and_type;
  unsigned kept;
};

/// For each byte of sixteen lanes: the byte of sixteen cells that goes there.
struct CellBytes {
  alignas(64) std::uint8_t raw[64]{};
  alignas(64) std::uint8_t intensity[64]{};
  constexpr CellBytes() {
    for (std::size_t i = 0; i < kLanes; ++i) {
      raw[4 * i] = static_cast<std::uint8_t>(kCellBytes * i);
      raw[4 * i + 1] = static_cast<std::uint8_t>(kCellBytes * i + 1);
      intensity[4 * i] = static_cast<std::uint8_t>(kCellBytes * i + 2);
    }
  }
};
constexpr CellBytes kBytes;
constexpr __mmask64 kRawBytes = 0x3333333333333333;
constexpr __mmask64 kIntensityBytes = 0x1111111111111111;

ZLOAM_AVX512 Cells read_cells(const std::uint8_t* at, const BeamTables& beams, std::size_t channel,
                              const BlockFrame& frame, RawLimits limits, __m512i common_time_ns,
                              __m512i types) {
  // Not a byte beyond the last cell: the last block is followed by the packet's end.
  const __m512i cells = _mm512_maskz_loadu_epi8((1ULL << kLanes * kCellBytes) - 1, at);
  const __m512i raw =
      _mm512_maskz_permutexvar_epi8(kRawBytes, _mm512_load_si512(kBytes.raw), cells);
  const __m512i above = _mm512_sub_epi32(raw, _mm512_set1_epi32(static_cast<int>(limits.lowest)));
  const __mmask16 kept =
      _mm512_cmple_epu32_mask(above, _mm512_set1_epi32(static_cast<int>(limits.span)));
  const __m512 intensity = _mm512_cvtepi32_ps(
      _mm512_maskz_permutexvar_epi8(kIntensityBytes, _mm512_load_si512(kBytes.intensity), cells));
  const __m512 range_m = _mm512_cvtepi32_ps(raw) * frame.unit_m;
  const __m512 along = _mm512_loadu_ps(&beams.along[channel]);
  const __m512 across = _mm512_loadu_ps(&beams.across[channel]);
  const __m512 x = range_m * (along * frame.cos_azimuth - across * frame.sin_azimuth);
  const __m512 y = -range_m * (along * frame.sin_azimuth + across * frame.cos_azimuth);
  const __m512 z =
      range_m * _mm512_loadu_ps(&beams.up[channel]) + _mm512_loadu_ps(&beams.height_m[channel]);
  const __m512i time_ns = _mm512_loadu_si512(&beams.time_ns[channel]);
  const __m512i ring = _mm512_loadu_si512(&beams.ring[channel]);
  return {_mm512_maskz_compress_ps(kept, x),
          _mm512_maskz_compress_ps(kept, y),
          _mm512_maskz_compress_ps(kept, z),
          _mm512_maskz_compress_ps(kept, intensity),
          _mm512_maskz_compress_epi32(kept, _mm512_add_epi32(time_ns, common_time_ns)),
          _mm512_maskz_compress_epi32(kept, _mm512_or_si512(ring, types)),
          kept};
}

/// The eight bytes of two members, of the low or the high eight points.
ZLOAM_AVX512 __m512i pairs(__m512i first, __m512i second, bool high) {
  const __m512i low_points =
      _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
  const __m512i chosen = high ? _mm512_add_epi32(low_points, _mm512_set1_epi32(8)) : low_points;
  return _mm512_permutex2var_epi32(first, chosen, second);
}

/// Eight points as they lie in memory: three eights of bytes each.
ZLOAM_AVX512 void put_eight(std::uint8_t* at, __m512i xy, __m512i zi, __m512i rest) {
  // Of x and y 0 to 7, of z and intensity 8 to 15; where the rests go, anything.
  const __m512i first = _mm512_setr_epi64(0, 8, 0, 1, 9, 0, 2, 10);
  const __m512i middle = _mm512_setr_epi64(0, 3, 11, 0, 4, 12, 0, 5);
  const __m512i last = _mm512_setr_epi64(13, 0, 6, 14, 0, 7, 15, 0);
  const __m512i first_rests = _mm512_setr_epi64(0, 0, 0, 0, 0, 1, 0, 0);
  const __m512i middle_rests = _mm512_setr_epi64(2, 0, 0, 3, 0, 0, 4, 0);
  const __m512i last_rests = _mm512_setr_epi64(0, 5, 0, 0, 6, 0, 0, 7);
  const __m512i a = _mm512_mask_permutexvar_epi64(_mm512_permutex2var_epi64(xy, first, zi),
                                                  0b00100100, first_rests, rest);
  const __m512i b = _mm512_mask_permutexvar_epi64(_mm512_permutex2var_epi64(xy, middle, zi),
                                                  0b01001001, middle_rests, rest);
  const __m512i c = _mm512_mask_permutexvar_epi64(_mm512_permutex2var_epi64(xy, last, zi),
                                                  0b10010010, last_rests, rest);
  _mm512_storeu_si512(at, a);
  _mm512_storeu_si512(at + 64, b);
  _mm512_storeu_si512(at + 128, c);
}

ZLOAM_AVX512 void put_cells(const Cells& cells, Writer& writer) {
  const __m512i x = _mm512_castps_si512(cells.x);
  const __m512i y = _mm512_castps_si512(cells.y);
  const __m512i z = _mm512_castps_si512(cells.z);
  const __m512i intensity = _mm512_castps_si512(cells.intensity);
  put_eight(writer.at(), pairs(x, y, false), pairs(z, intensity, false),
            pairs(cells.time_ns, cells.ring_and_type, false));
  put_eight(writer.at() + 8 * sizeof(Point), pairs(x, y, true), pairs(z, intensity, true),
            pairs(cells.time_ns, cells.ring_and_type, true));
  writer.count += static_cast<std::size_t>(__builtin_popcount(cells.kept));
}

ZLOAM_AVX512 void put_block(const FiredBlock& fired, const BeamTables& beams, int bank,
                            RawLimits limits, ReturnType type, Writer& writer) {
  const auto& [block, frame] = fired;
  const __m512i time_ns = _mm512_set1_epi32(static_cast<int>(frame.time_ns));
  const __m512i types = _mm512_set1_epi32(static_cast<int>(type_bits(type)));
  for (int c = 0; c < kCellsPerBlock; c += kLanes) {
    const std::size_t channel = channel_of(bank, c);
    writer.fill_columns(column_of(frame, beams, channel), 1);
    const std::uint8_t* at =
        block + kFlagAndAzimuthBytes + kCellBytes * static_cast<std::size_t>(c);
    put_cells(read_cells(at, beams, channel, frame, limits, time_ns, types), writer);
  }
}

static_assert(kLanes == kChannelsPerColumn && sizeof(Point) == 24);

}  // namespace

__attribute__((target("avx512f,avx512bw,avx512vbmi"))) void put_single_avx512(
    std::span<const FiredBlock> blocks, const BeamTables& beams, int bank, RawLimits limits,
    ReturnType type, PointSink& sink) {
  Writer writer(sink);
  for (const FiredBlock& fired : blocks) put_block(fired, beams, bank, limits, type, writer);
  sink.count = writer.count;
}

}  // namespace zloam::driver

#endif
