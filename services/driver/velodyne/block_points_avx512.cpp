#include "driver/velodyne/block_points_wide.hpp"

#if ZLOAM_WIDE

#include "driver/decoder/sixteen_points.hpp"
#include "driver/velodyne/block_writer.hpp"

namespace zloam::driver::velodyne {
namespace {

constexpr int kLanes = 16;

/// For each byte of sixteen lanes, the index of the cells' byte that is moved there.
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

ZLOAM_AVX512 Sixteen read_cells(const std::uint8_t* at, const BeamTables& beams,
                                std::size_t channel, const BlockFrame& frame, RawLimits limits,
                                __m512i common_time_ns, __m512i types) {
  // Masked, so that nothing beyond the last cell is read: the last block is at the packet's end.
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
  return {
      x,   y, z, intensity, _mm512_add_epi32(time_ns, common_time_ns), _mm512_or_si512(ring, types),
      kept};
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
    writer.count +=
        put_kept(read_cells(at, beams, channel, frame, limits, time_ns, types), writer.at());
  }
}

static_assert(kLanes == kChannelsPerColumn && sizeof(Point) == 24);

}  // namespace

__attribute__((target(ZLOAM_AVX512_TARGET))) void put_single_avx512(
    std::span<const FiredBlock> blocks, const BeamTables& beams, int bank, RawLimits limits,
    ReturnType type, PointSink& sink) {
  Writer writer(sink);
  for (const FiredBlock& fired : blocks) put_block(fired, beams, bank, limits, type, writer);
  sink.count = writer.count;
}

}  // namespace zloam::driver::velodyne

#endif
