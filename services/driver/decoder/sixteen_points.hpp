#pragma once
// Writes sixteen points at once, from a register for each member to their places in memory. Only
// for files compiled where wide.hpp sets ZLOAM_WIDE, and run where has_avx512().

#include <immintrin.h>

#include <cstddef>
#include <cstdint>

#include "common/geometry/point.hpp"

#define ZLOAM_AVX512_TARGET "avx512f,avx512bw,avx512vbmi"
#define ZLOAM_AVX512 __attribute__((target(ZLOAM_AVX512_TARGET), always_inline)) inline

namespace zloam::driver {

struct Sixteen {
  __m512 x, y, z, intensity;
  __m512i time_ns, ring_and_type;
  /// which of them are points
  __mmask16 kept;
};

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

/// Writes the kept points, in order; there must be room for all sixteen. Returns their number.
ZLOAM_AVX512 std::size_t put_kept(const Sixteen& points, std::uint8_t* at) {
  const __mmask16 kept = points.kept;
  const __m512i x = _mm512_castps_si512(_mm512_maskz_compress_ps(kept, points.x));
  const __m512i y = _mm512_castps_si512(_mm512_maskz_compress_ps(kept, points.y));
  const __m512i z = _mm512_castps_si512(_mm512_maskz_compress_ps(kept, points.z));
  const __m512i intensity = _mm512_castps_si512(_mm512_maskz_compress_ps(kept, points.intensity));
  const __m512i time_ns = _mm512_maskz_compress_epi32(kept, points.time_ns);
  const __m512i ring_and_type = _mm512_maskz_compress_epi32(kept, points.ring_and_type);
  put_eight(at, pairs(x, y, false), pairs(z, intensity, false),
            pairs(time_ns, ring_and_type, false));
  put_eight(at + 8 * sizeof(Point), pairs(x, y, true), pairs(z, intensity, true),
            pairs(time_ns, ring_and_type, true));
  return static_cast<std::size_t>(__builtin_popcount(kept));
}
static_assert(sizeof(Point) == 24);

}  // namespace zloam::driver
