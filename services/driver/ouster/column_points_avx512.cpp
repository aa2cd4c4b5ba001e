#include "driver/ouster/column_points_wide.hpp"

#if ZLOAM_WIDE

#include "driver/decoder/sixteen_points.hpp"

namespace zloam::driver::ouster {
namespace {

constexpr std::size_t kLanes = 16;
constexpr __mmask16 kFirstOfPairs = 0x5555;
// Used with the masked forms of intrinsics: GCC warns of uninitialized values in some unmasked ones
// (bug 105593).
constexpr __mmask16 kAll = 0xFFFF;
// Prefetch distance. Packets are longer than a page, and the processor's own prefetching stops at
// the end of a page.
constexpr std::size_t kAheadBytes = 4096;

ZLOAM_AVX512 __m512i all(std::uint32_t value) { return _mm512_set1_epi32(static_cast<int>(value)); }

/// Alternates the values for the first and the second return of each pair.
ZLOAM_AVX512 __m512i in_turns(const std::array<ReturnType, 2>& types) {
  return _mm512_mask_blend_epi32(kFirstOfPairs, all(bits_of(types[1])), all(bits_of(types[0])));
}
ZLOAM_AVX512 __mmask16 in_turns(const std::array<bool, 2>& kept) {
  const unsigned first = kept[0] ? kFirstOfPairs : 0U;
  const unsigned second = kept[1] ? ~unsigned{kFirstOfPairs} & 0xFFFFU : 0U;
  return static_cast<__mmask16>(first | second);
}

/// Values common to all lanes.
struct Common {
  __m512i mask, lowest, span, single_type, farther_types, nearer_types;
  __mmask16 kept_if_farther, kept_if_nearer;
};

ZLOAM_AVX512 Common common_of(const ColumnReader& reader) {
  return {all(reader.range_mm.mask),
          all(reader.limits.lowest_mm),
          all(reader.limits.span_mm),
          all(bits_of(reader.single_type)),
          in_turns(reader.rule.type_if_farther),
          in_turns(reader.rule.type_if_nearer),
          in_turns(reader.rule.kept_if_farther),
          in_turns(reader.rule.kept_if_nearer)};
}

/// Which lanes are kept, and their types; the same rule as choose() in column_points.cpp.
ZLOAM_AVX512 __mmask16 choose(__m512i range_mm, __mmask16 own, const Common& common,
                              __m512i& types) {
  const __m512i other_mm = _mm512_maskz_shuffle_epi32(kAll, range_mm, _MM_PERM_CDAB);
  const __mmask16 other =
      _mm512_cmple_epu32_mask(_mm512_sub_epi32(other_mm, common.lowest), common.span);
  const __mmask16 farther = other & _mm512_cmpgt_epu32_mask(range_mm, other_mm);
  const __mmask16 nearer = other & _mm512_cmplt_epu32_mask(range_mm, other_mm);
  const __mmask16 same = other & _mm512_cmpeq_epi32_mask(range_mm, other_mm);
  types = all(bits_of(ReturnType::kBoth));
  types = _mm512_mask_mov_epi32(types, farther, common.farther_types);
  types = _mm512_mask_mov_epi32(types, nearer, common.nearer_types);
  const auto alone = static_cast<__mmask16>(~unsigned{other});
  return own & (alone | (farther & common.kept_if_farther) | (nearer & common.kept_if_nearer) |
                (same & kFirstOfPairs));
}

/// Indices of sixteen lanes' words relative to the first of these words, the same for each block of
/// sixteen lanes of a column. A gather instruction would take four times as long.
struct Places {
  __m512i range, reflectivity;
  __mmask16 range_beyond_32, reflectivity_beyond_32;
  /// registers needed for these words, and bytes from one block of lanes to the next
  int registers;
  std::size_t stride;
};

ZLOAM_AVX512 Places places_of(const ColumnReader& reader) {
  const __m512i at = _mm512_loadu_si512(reader.at.data());
  const __m512i range = _mm512_maskz_srli_epi32(kAll, at, 2);
  const __m512i reflectivity =
      _mm512_add_epi32(range, all(static_cast<std::uint32_t>(reader.reflectivity_at / 4)));
  const std::size_t stride = 4 * reader.words / (reader.lanes / kLanes);
  return {range,
          reflectivity,
          _mm512_cmpge_epu32_mask(range, all(32)),
          _mm512_cmpge_epu32_mask(reflectivity, all(32)),
          static_cast<int>((stride + 63) / 64),
          stride};
}

ZLOAM_AVX512 __m512i pick(const __m512i* words, int registers, __m512i places,
                          __mmask16 beyond_32) {
  const __m512i low = _mm512_permutex2var_epi32(words[0], places, words[1]);
  if (registers <= 2) return low;
  return _mm512_mask_mov_epi32(low, beyond_32,
                               _mm512_permutex2var_epi32(words[2], places, words[3]));
}

struct Words {
  __m512i range_mm;
  __m512i reflectivity;
};

ZLOAM_AVX512 Words words_of(const std::uint8_t* at, const ColumnReader& reader,
                            const Places& places, const Common& common) {
  __m512i words[4] = {};
  // Masked, so that nothing beyond the sixteen lanes is read: the last ones are at the packet's
  // end.
  for (int i = 0; i < places.registers; ++i) {
    const std::size_t left = places.stride / 4 - kLanes * static_cast<std::size_t>(i);
    const auto mask = static_cast<__mmask16>(left >= kLanes ? 0xFFFFU : (1U << left) - 1U);
    words[i] = _mm512_maskz_loadu_epi32(mask, at + 64 * i);
    _mm_prefetch(at + 64 * i + kAheadBytes, _MM_HINT_T0);
  }
  const __m512i word = pick(words, places.registers, places.range, places.range_beyond_32);
  const bool same_word = reader.reflectivity_at < 4;
  const __m512i beside =
      same_word ? word
                : pick(words, places.registers, places.reflectivity, places.reflectivity_beyond_32);
  return {
      _mm512_maskz_slli_epi32(kAll, _mm512_and_si512(word, common.mask),
                              static_cast<unsigned>(reader.range_mm.shift)),
      _mm512_and_si512(_mm512_maskz_srli_epi32(
                           kAll, beside, static_cast<unsigned>(8 * (reader.reflectivity_at % 4))),
                       all(0xFF))};
}

ZLOAM_AVX512 Sixteen read_lanes(const Words& words, const ColumnReader& reader, std::size_t lane,
                                const MeasuredColumn& column, const Common& common) {
  const __mmask16 own =
      _mm512_cmple_epu32_mask(_mm512_sub_epi32(words.range_mm, common.lowest), common.span);
  __m512i types = common.single_type;
  const __mmask16 kept = reader.returns == 1 ? own : choose(words.range_mm, own, common, types);
  const __m512 r = _mm512_cvtepi32_ps(words.range_mm);
  __m512 local[3];
  for (std::size_t k = 0; k < 3; ++k) {
    local[k] =
        _mm512_loadu_ps(&reader.scale[k][lane]) * r + _mm512_loadu_ps(&reader.offset[k][lane]);
  }
  __m512 xyz[3];
  for (std::size_t k = 0; k < 3; ++k) {
    const auto& row = column.pose->rows[k];
    xyz[k] = local[0] * row[0] + local[1] * row[1] + local[2] * row[2] + row[3];
  }
  const __m512i ring = _mm512_loadu_si512(&reader.ring[lane]);
  return {xyz[0],
          xyz[1],
          xyz[2],
          _mm512_cvtepi32_ps(words.reflectivity),
          all(column.time_ns),
          _mm512_or_si512(ring, types),
          kept};
}

}  // namespace

__attribute__((target(ZLOAM_AVX512_TARGET))) std::size_t put_columns_avx512(
    std::span<const MeasuredColumn> columns, const ColumnReader& reader, Point* out,
    std::uint16_t* out_columns) {
  const Common common = common_of(reader);
  const Places places = places_of(reader);
  std::size_t count = 0;
  for (const MeasuredColumn& column : columns) {
    const std::uint8_t* at = column.pixels;
    const __m256i filled = _mm256_set1_epi16(static_cast<short>(column.column));
    for (std::size_t lane = 0; lane < reader.lanes; lane += kLanes, at += places.stride) {
      const Words words = words_of(at, reader, places, common);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(out_columns + count), filled);
      count += put_kept(read_lanes(words, reader, lane, column, common),
                        reinterpret_cast<std::uint8_t*>(out + count));
    }
  }
  return count;
}

}  // namespace zloam::driver::ouster

#endif
