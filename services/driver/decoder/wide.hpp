#pragma once
// Whether code for wider registers may be compiled beside the portable code, and run.

#if defined(__x86_64__)
#define ZLOAM_WIDE 1
#else
#define ZLOAM_WIDE 0
#endif

namespace zloam::driver {

#if ZLOAM_WIDE
inline bool has_avx2() {
  static const bool kHas = __builtin_cpu_supports("avx2");
  return kHas;
}

/// Only with byte permutation: earlier processors slow down when 512 bits are used.
inline bool has_avx512() {
  static const bool kHas = __builtin_cpu_supports("avx512f") &&
                           __builtin_cpu_supports("avx512bw") &&
                           __builtin_cpu_supports("avx512vbmi");
  return kHas;
}
#endif

}  // namespace zloam::driver
