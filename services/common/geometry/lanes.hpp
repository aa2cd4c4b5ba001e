#pragma once
// Four numbers at once, in the compilers' vector types (GCC's and Clang's alike): SSE2 on x86-64,
// NEON on arm64, plain code elsewhere. Points and rows of planes take one such vector each.

#include <array>
#include <cstdint>

#include "common/geometry/se3.hpp"

namespace zloam {

using Float4 = float __attribute__((vector_size(16)));

inline Float4 all_lanes(float x) { return Float4{x, x, x, x}; }

template <int i>
Float4 from_lane(Float4 v) {
  return __builtin_shufflevector(v, v, i, i, i, i);
}

/// (x, y, z, 0)
inline Float4 lanes_of(const Eigen::Vector3f& v) { return Float4{v.x(), v.y(), v.z(), 0.0f}; }

/// (y, z, x, w)
inline Float4 turned(Float4 v) { return __builtin_shufflevector(v, v, 1, 2, 0, 3); }

/// Lanes z, x, y of the cross product of two vectors whose last lane is finite; 0 in the last.
inline Float4 cross_zxy(Float4 a, Float4 b) { return a * turned(b) - turned(a) * b; }

inline float sum_of_lanes(Float4 v) {
  const Float4 pairs = v + __builtin_shufflevector(v, v, 2, 3, 0, 1);
  return (pairs + __builtin_shufflevector(pairs, pairs, 1, 0, 3, 2))[0];
}

/// Whether every lane is below the limit in magnitude; false for NaN.
inline bool all_below(Float4 v, float limit) {
  using Long2 = std::int64_t __attribute__((vector_size(16)));
  const Long2 below = reinterpret_cast<Long2>((v < limit) & (v > -limit));
  return (below[0] & below[1]) == -1;
}

/// Two numbers in double precision.
using Double2 = double __attribute__((vector_size(16)));

/// Rounded down; for numbers of at most 2^51 in magnitude.
inline Double2 floor_of(Double2 v) {
  constexpr double kUnits = 3.0 * (std::uint64_t{1} << 51);  // so large that its digits are whole
  const Double2 nearest = (v + kUnits) - kUnits;
  return nearest > v ? nearest - 1.0 : nearest;
}

/// Whether all four are at least -limit and below limit; false for NaN.
inline bool all_within(Double2 a, Double2 b, double limit) {
  const auto within = (a < limit) & (a >= -limit) & (b < limit) & (b >= -limit);
  return (within[0] & within[1]) == -1;
}

using Int4 = std::int32_t __attribute__((vector_size(16)));

/// Rounded down; within the range of the integers.
inline Int4 floor_to_int(Float4 v) {
  const Int4 cut = __builtin_convertvector(v, Int4);
  return cut + (__builtin_convertvector(cut, Float4) > v);
}

inline Int4 least_of(Int4 a, Int4 b) { return a < b ? a : b; }
inline Int4 most_of(Int4 a, Int4 b) { return a > b ? a : b; }

/// Columns of a motion in single precision; their last lanes are 0.
struct MotionLanes {
  std::array<Float4, 4> columns;

  MotionLanes() = default;
  explicit MotionLanes(const Pose& motion) {
    for (Eigen::Index k = 0; k < 4; ++k) {
      columns[static_cast<std::size_t>(k)] =
          lanes_of(motion.matrix().col(k).head<3>().cast<float>());
    }
  }

  /// (x, y, z, 0)
  Float4 operator()(float x, float y, float z) const {
    return columns[0] * x + columns[1] * y + columns[2] * z + columns[3];
  }
};

}  // namespace zloam
