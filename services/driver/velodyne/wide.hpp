#pragma once
// Whether code for AVX2 may be compiled beside the portable one, and run.

#if defined(__x86_64__)
#define ZLOAM_WIDE 1
#else
#define ZLOAM_WIDE 0
#endif

namespace zloam::driver {

#if ZLOAM_WIDE
inline bool has_wide() {
  static const bool kHas = __builtin_cpu_supports("avx2");
  return kHas;
}
#endif

}  // namespace zloam::driver
