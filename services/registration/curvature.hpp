#pragma once
// Second step of registration: breaks, unreliable points and curvature of each ring.
//
// Curvature (LOAM, equation 1): d_i = sum over k neighbours on either side of (p_j - p_i). Along
// the beam its noise has the variance (2 k + 4 k^2) sigma_r^2: 110 sigma_r^2 for k = 5. On a plane
// that is seen obliquely the points are spaced unevenly, so d_i lies along the surface; only the
// component across the chord between both sides bends, and only it is tested:
//   chi2_i = |d_i, across|^2 / ((2 k + 4 k^2) sigma_r^2 sin^2(beam, chord)).

#include <cstdint>
#include <vector>

#include "registration/ring_sort.hpp"

namespace zloam::registration {

enum class Kind : std::uint8_t {
  kPlain,       ///< curvature known, not unreliable
  kUnknown,     ///< too near to an end or a break for a curvature
  kSilhouette,  ///< near side of an occlusion edge
  kParallel,    ///< surface nearly parallel to the beam
  kOccluded     ///< far side of an occlusion edge
};

/// Parallel to RingSorted::points.
struct Curvature {
  std::vector<Kind> kind;
  /// squared curvature in variances; for silhouettes that of the step in depth
  std::vector<float> chi2;
  /// tangent of half the angle by which the two sides bend: 0 on a plane, 1 at a right angle
  std::vector<float> bend;
  /// true at i: the surface ends between point i and point i + 1
  std::vector<std::uint8_t> break_after;
  /// component of d along the beam over sqrt(2 k + 4 k^2), m, of each smooth point in order
  std::vector<float> beam_component_m;
};

Curvature compute_curvature(const RingSorted& sorted, const RegistrationConfig& config);

}  // namespace zloam::registration
