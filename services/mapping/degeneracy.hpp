#pragma once
// Which directions of a pose the data fix, judged without units or point counts.
//
// Translation and rotation are looked at separately, each with the other one free (Schur
// complement; after DCReg 2025). Along an eigenvector the data give the sigma 1 / sqrt(lambda), the
// prediction the one of its own covariance; a direction is weak when the data say less than the
// prediction. Noise of the map's normals makes a smooth tunnel look observable by about N *
// var(normal): it is taken off lambda first.

#include <Eigen/Core>

#include "mapping/alignment.hpp"

namespace zloam::mapping {

struct WeakAxes {
  Degeneracy report;
  /// orthonormal, the directions to be cut from a step; zero columns where nothing is weak
  Matrix6 strong_projection = Matrix6::Identity();
};

/// was_degenerate: of the sweep before, for the hysteresis between degenerate_on and _off.
WeakAxes judge(const Matrix6& data_information, const Matrix6& noise_information,
               const Matrix6& prior_covariance, const MappingConfig& config, bool was_degenerate);

}  // namespace zloam::mapping
