#pragma once
// Registers one sweep against a plane map: Gauss-Newton over the pose at mid-sweep and the motion
// over the sweep, with deskewing and association repeated in each iteration, and with priors
// (maximum a posteriori). Solving about the middle decouples pose and motion. Sources: Zhang &
// Singh, LOAM (RSS 2014), for deskewing inside the iteration; Dellenbach et al., CT-ICP (ICRA
// 2022), for soft ties between sweeps instead of a fixed start.

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "common/plane_map/config.hpp"
#include "common/plane_map/normal_equations.hpp"

namespace zloam::plane_map {

/// Quadratic priors on a sweep's motion; order x y z rx ry rz, pose before twist (per sweep).
struct MotionPrior {
  SweepMotion start;  // the iteration starts here

  /// Motion predicted from the sweep before, with the information of
  /// (Log(T_mid_predicted^-1 T_mid), twist - twist_predicted).
  SweepMotion predicted;
  Matrix12 information = Matrix12::Zero();
  /// The information without the IMU, where there is one: a direction is degenerate if its measured
  /// sigma is worse than this one, not because the IMU knows it even better.
  std::optional<Matrix12> usual_information;

  /// Sigma of the bend about zero, in each axis.
  Vector6 bend_sigma = Vector6::Zero();

  /// Motion predicted by another estimator (odometry), with its information.
  SweepMotion advised;
  Matrix12 advice_information = Matrix12::Zero();

  /// Weak axis of the sweep before, in the grid; zero: none was weak.
  Eigen::Vector3d weak_axis_grid = Eigen::Vector3d::Zero();
};

/// A direction becomes degenerate when its measured sigma exceeds kWeakRatio predicted sigmas, and
/// stays so until it is at most kStrongRatio predicted sigmas.
inline constexpr double kWeakRatio = 0.7;
inline constexpr double kStrongRatio = 0.5;

/// One sigma along a direction about which the data give no information.
inline constexpr double kNothingKnown_m = 1000.0;

/// The least constrained translation direction by the data alone, without the priors.
struct Degeneracy {
  bool weak = false;
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();  // frame base_link at mid-sweep, unit
  double measured_sigma_m = 0.0;                   // sigma along the axis from the data
  double predicted_sigma_m = 0.0;                  // sigma along it from the priors
  double share = 0.0;         // mean squared share of the normals along the axis, [0, 1]
  double second_share = 0.0;  // the same along the next weakest direction
  /// The least constrained rotation, with lever arm (m) = rms distance of the matched points.
  Eigen::Vector3d rotation_axis = Eigen::Vector3d::Zero();
  double measured_sigma_rad = 0.0;
  double predicted_sigma_rad = 0.0;
};

/// Error of the bend: -by_motion times that of the other unknowns, and an independent part.
struct Bend {
  Eigen::Matrix<double, 6, 12> by_motion = Eigen::Matrix<double, 6, 12>::Zero();
  Matrix6 own_covariance = Matrix6::Zero();
};

struct MatchResult {
  bool valid = false;  // false: too few matches or no finite solution; motion = prior.start
  SweepMotion motion;
  Matrix12 covariance = Matrix12::Zero();  // of (T_mid right perturbation, twist per sweep)
  double seen_at = 0.0;                    // of the points (common/geometry/motion_covariance.hpp)
  Bend bend;
  Degeneracy degeneracy;
  /// Residuals of points against planes, weighted by the roots of the first gate kernel's weights:
  /// a fine kernel, three times the noise, would leave no large residuals. inlier_rms_m: with the
  /// whole weights, which exclude points that the map does not know.
  double residual_rms_m = 0.0;
  double inlier_rms_m = 0.0;
  double matched_fraction = 0.0;
  double matched_weight = 0.0;  // sum of the robust weights
  /// The same sum with each point counted fully, and always with the fine kernel: to compare
  /// matches at several places, whatever kernel the matching began with.
  double explained_weight = 0.0;
  std::size_t tried = 0;
  std::size_t matches = 0;
  int iterations = 0;
  bool converged = false;
};

/// Gates of the iterations of one sweep. The first one admits the prediction's error; afterwards a
/// point that far off belongs to another surface or to an object that has moved.
struct MatchGates {
  Gate first;
  /// Mean squared share of the normals along the least constrained direction, of the sweeps before;
  /// nothing: only the first iteration's share is known.
  std::optional<double> share;
};

class SweepMatcher {
 public:
  explicit SweepMatcher(const MatcherConfig& config) : config_(config) {}

  /// The map's anchor must have been set near the prior's start.
  MatchResult match(VoxelPlaneMap& map, const SweepPoints& sweep, const MotionPrior& prior,
                    const MatchGates& gates);

 private:
  struct Step {
    SweepSums sums;
    Matrix12 h = Matrix12::Zero();  // with the priors, the bend eliminated
    Vector12 step = Vector12::Zero();
    Vector6 bend_step = Vector6::Zero();
    Bend bend;
  };

  /// The gate after the first iteration.
  Gate fine_gate(const MatchGates& gates, const NormalSums& first) const;
  Step step_from(const SweepMotion& motion, VoxelPlaneMap& map, const SweepPoints& sweep,
                 MatchedPoints& matched, const MotionPrior& prior, const Gate& gate) const;
  SweepMotion come_near(VoxelPlaneMap& map, const SweepPoints& sweep, const MotionPrior& prior,
                        const Gate& gate) const;
  /// Information of one squared residual.
  double information_scale(const VoxelPlaneMap& map) const;
  /// Weighted sum of squared normals along one direction that may be errors alone.
  double spurious(const NormalSums& sums) const;
  /// Removes the spurious part along the least constrained translation, but only between walls.
  void discount_spurious(const NormalSums& sums, Matrix18& h, Vector18& g) const;
  /// lever2: sum of the weighted squared lever arms, m^2.
  Degeneracy judge(const NormalSums& sums, double lever2, const Matrix12& predicted,
                   double scale) const;

  MatcherConfig config_;
  MatchedPoints matched_;
};

/// Hessian and gradient of the priors at a motion; for tests and for the predicted sigmas.
void add_priors(const MotionPrior& prior, const SweepMotion& motion, Matrix12& h, Vector12& g);

}  // namespace zloam::plane_map
