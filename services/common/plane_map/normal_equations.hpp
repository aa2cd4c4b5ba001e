#pragma once
// Sums of the point-to-plane problem over one sweep with twelve unknowns, in one pass.

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "common/geometry/se3.hpp"
#include "common/plane_map/sweep_points.hpp"
#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {

/// Motion of base_link over one sweep: T_mid * Exp(s twist + s^2 bend / 2), s in [-1/2, 1/2] of the
/// sweep.
struct SweepMotion {
  Pose T_mid = Pose::Identity();
  Vector6 twist = Vector6::Zero();  // at the middle, over the whole sweep: m, rad
  Vector6 bend = Vector6::Zero();   // change of the twist from begin to end: m, rad

  Pose at(double s) const { return T_mid * exp_se3(s * twist + 0.5 * s * s * bend); }
  template <class Bits>
  void each(Bits& bits) {
    bits(T_mid, twist, bend);
  }
};

using Matrix18 = Eigen::Matrix<double, 18, 18>;
using Vector18 = Eigen::Matrix<double, 18, 1>;

/// If J is the row of one residual for a right perturbation of T_mid, its row for the twist is s J
/// and that for the bend s^2 J / 2 (to first order in the sweep's motion). So sums of 6x6,
/// a_k = sum w s^k JJ', g_k = sum w r s^k J, represent the problem.
struct NormalSums {
  Matrix6 a0 = Matrix6::Zero();
  Matrix6 a1 = Matrix6::Zero();
  Matrix6 a2 = Matrix6::Zero();
  Matrix6 a3 = Matrix6::Zero();
  Matrix6 a4 = Matrix6::Zero();
  Vector6 g0 = Vector6::Zero();
  Vector6 g1 = Vector6::Zero();
  Vector6 g2 = Vector6::Zero();
  double weight = 0.0;           // sum of weights
  double normal_variance = 0.0;  // sum of weighted variances of normals, rad^2
  std::size_t matches = 0;

  /// For pose, twist and bend.
  Matrix18 hessian() const;
  Vector18 gradient() const;
};

/// Sums of the points that met a plane, and of those that met a distribution.
struct SweepSums {
  NormalSums planes;
  NormalSums blobs;
};

/// A poorly constrained direction of the grid. The walls along it give no information about it, but
/// the errors of their normals add up to a false stiffness and force along it.
struct WeakAxis {
  Eigen::Vector3f axis_grid = Eigen::Vector3f::Zero();  // unit; zero: there is none
  float least_cosine = 0.0f;  // normals nearer to perpendicular than this are ignored along it
};

/// Residual of a point that met a plane.
struct PlaneResidual {
  float squared_m2, weight, lever2_m2;
};

/// Computed from the residuals of the last iteration only, with a separate kernel, as that of the
/// iteration may be too fine to show large residuals: sums of the weights and of their roots, and
/// of the squared residuals (m^2) with the weights and with their roots.
struct ResidualAccount {
  double told_weight = 0.0, told_root = 0.0;
  double told_squared = 0.0, told_root_squared = 0.0;
  double lever2 = 0.0;  // sum of weighted squared lever arms, m^2
  double fine_weight = 0.0;
};

/// Points of a sweep, each with its result in the map from the iteration before: most points stay
/// in their voxel. One such object is reused for all sweeps: the hints take a megabyte, which the
/// kernel would otherwise map and clear for each sweep.
struct MatchedPoints {
  /// Starts another sweep; its points must stay where they are until the next one.
  void begin(const std::vector<SlotPoint>& of_sweep) {
    points = of_sweep;
    hints.resize(of_sweep.size());
    are_new = true;
  }
  std::span<const SlotPoint> points;
  std::vector<VoxelPlaneMap::Hint> hints;
  std::vector<PlaneResidual> residuals;  // of those that met planes, by accumulate()
  bool are_new = true;  // nothing was looked up for them yet: the hints are meaningless
};

/// Residuals above the limit are rejected; the others weigh (k^2 / (k^2 + r^2))^2 with the kernel k
/// (Geman-McClure). Each of n correlated points (Match::crowd) counts 1 / (1 + n / crowd_points);
/// 0: fully.
struct Gate {
  double limit_m = 0.0;
  double kernel_m = 0.0;
  double crowd_points = 0.0;
};

/// Transforms points as given to the map's local coordinates; shift_local: of the motions' origin.
void to_local(std::span<const SlotPoint> points, const SlotMotions& motions,
              const Eigen::Vector3f& shift_local, std::vector<LocalPoint>& out);

/// Matches points with the map; the gate is that of planes. The motion is in the map's grid frame.
SweepSums accumulate(VoxelPlaneMap& map, const SweepPoints& sweep, MatchedPoints& matched,
                     const SweepMotion& motion, const Gate& gate, const WeakAxis& weak = {});

ResidualAccount account_of(std::span<const PlaneResidual> residuals, double kernel_m,
                           double fine_kernel_m);

}  // namespace zloam::plane_map
