#pragma once
// Motion of one sweep from point-to-plane residuals.
//
// Unknowns: T = T_odom_mid, the pose of base_link halfway between begin and end, v, the body twist
// over the sweep (per sweep, not per second), and b, the change of v over the sweep. A point p
// measured at the fraction s of the sweep, s in [-1/2, 1/2], lies at T M(s) p,
// M(s) = Exp(s v) Exp((s^2 - 1/4) / 2 b): begin and end do not depend on b, which is eliminated
// from the system. About the middle T and v nearly decouple.
//   plane   r = n . (T M(s) p) - d
//   prior   e_begin = Log(T_begin^-1 T Exp(-v / 2)),  e_twist = v - v_prior,  e_bend = b - b_prior
// Cost: 1/2 sum_i w_i rho(|r_i|^2) + 1/2 |e|^2 / sigma^2, rho(x) = k^2 x / (k^2 + x)
// (Geman-McClure). Minimised by Gauss-Newton with re-weighting; perturbations T <- T Exp(x_T),
// v <- v + x_v. The soft tie to the sweep before is CT-ICP's (Dellenbach et al. 2022), not LOAM's
// fixed start; the matching is LOAM's (Zhang and Singh, RSS 2014, section V).

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/geometry/se3.hpp"

namespace zloam::odometry {

struct MotionState {
  Pose T_odom_mid = Pose::Identity();
  Vector6 twist = Vector6::Zero();  ///< per sweep
  Vector6 bend = Vector6::Zero();   ///< change of the twist within the sweep

  Pose T_odom_begin() const { return T_odom_mid * exp_se3(-0.5 * twist); }
  Pose T_odom_end() const { return T_odom_mid * exp_se3(0.5 * twist); }
};

/// The sweep's time in kTimeBins steps: all points of a step share M(s). Half a step is 0.1 ms
/// of a 0.1 s sweep: 2 mm at 20 m/s.
inline constexpr int kTimeBins = 512;
inline double fraction_of_bin(int bin) { return static_cast<double>(bin) / kTimeBins - 0.5; }

struct PlaneResidual {
  Eigen::Vector3d point;   ///< frame base_link at its own time
  Eigen::Vector3d normal;  ///< unit, frame odom
  double offset;           ///< normal . (point of the plane)
  double weight;           ///< 1 / variance, 1/m^2
  std::uint16_t bin;
};

struct Residuals {
  std::vector<PlaneResidual> planes;
};

/// Prior of a sweep's begin and twist, before the sweep is matched.
struct MotionPrior {
  Pose T_odom_begin = Pose::Identity();
  Vector6 twist = Vector6::Zero();
  /// Marginal sigmas of begin and twist: measurements are compared with them.
  Vector6 begin_sigma = Vector6::Ones();
  Vector6 twist_sigma = Vector6::Ones();
  /// Joint information, begin (tangent at the begin) before twist: used by the solver.
  Matrix12 information = Matrix12::Identity();
  /// Prior of the change of the twist within the sweep. A sigma of 0: it is known.
  Vector6 bend = Vector6::Zero();
  Vector6 bend_sigma = Vector6::Zero();
  /// Above 0 where the motion is known better than from the sweep before: information along the
  /// least constrained direction that such normal errors explain is removed (degeneracy.hpp).
  double normal_error_rad = 0.0;
};

/// The information of a begin and a twist with independent errors.
Matrix12 independent(const Vector6& begin_sigma, const Vector6& twist_sigma);

/// The information of a begin and a twist of this covariance; none when it is singular or not
/// finite.
std::optional<Matrix12> information_of(const Matrix12& covariance);

/// M(s) of every time bin.
class MotionTable {
 public:
  explicit MotionTable(const MotionState& state);
  const Pose& operator[](std::size_t bin) const { return motions_[bin]; }

 private:
  std::vector<Pose> motions_;
};

/// Gauss-Newton system: H x = -g.
struct NormalEquations {
  Matrix12 H = Matrix12::Zero();
  Vector12 g = Vector12::Zero();
  /// The blocks of the bend: with the other unknowns, with itself, and its gradient.
  Eigen::Matrix<double, 12, 6> H_bend = Eigen::Matrix<double, 12, 6>::Zero();
  Matrix6 H_bends = Matrix6::Zero();
  Vector6 g_bend = Vector6::Zero();
  double cost = 0.0;
  double weight_sum = 0.0;   ///< of robust weights in [0, 1]
  double squared_sum = 0.0;  ///< of the residuals, each by its robust weight, m^2
};

/// Left Jacobian of SE(3), Exp(x + dx) = Exp(J(x) dx) Exp(x), for x = s v at any s: a power series
/// in s (Barfoot 2017, section 7.1).
class LeftJacobian {
 public:
  explicit LeftJacobian(const Vector6& twist);
  Matrix6 at(double s) const;

 private:
  static constexpr std::size_t kMaxTerms = 20;
  // The right half of each: the left one is the lower block of it above zeros.
  using RightHalf = Eigen::Matrix<double, 6, 3>;
  std::array<RightHalf, kMaxTerms> terms_;
  std::size_t used_ = 1;
};

/// Adds the residuals' part at the state; table: of that state; with_bend: with the bend's blocks.
void add_residuals(const MotionState& state, const MotionTable& table, const Residuals& residuals,
                   double kernel_m, bool with_bend, NormalEquations& equations);

/// Adds the prior's part at the state.
void add_prior(const MotionState& state, const MotionPrior& prior, NormalEquations& equations);

/// Eliminates the bend, with its prior, from the system. The bend's step depends on that of the
/// other unknowns.
class EliminatedBend {
 public:
  EliminatedBend(const MotionState& state, const MotionPrior& prior, NormalEquations& equations);
  Vector6 step(const Vector12& of_others) const { return own_ - by_others_ * of_others; }

 private:
  Vector6 own_ = Vector6::Zero();
  Eigen::Matrix<double, 6, 12> by_others_ = Eigen::Matrix<double, 6, 12>::Zero();
};

/// The step -H^-1 g, and the state after it.
Vector12 solve_step(const NormalEquations& equations);
MotionState moved(const MotionState& state, const Vector12& step);

/// A motion and its covariance after a further measurement of zero twist, to sigma: the pose
/// follows through its correlation with the twist.
void hold_still(const Vector6& sigma, MotionState& state, Matrix12& covariance);

/// Jacobian of (pose at the fraction s of the sweep, twist) by the unknowns.
Matrix12 motion_jacobian(const MotionState& state, double s);
/// Covariance of (T_odom_end, twist) given that of the unknowns, tangent at base_link at the end.
Matrix12 end_covariance(const MotionState& state, const Matrix12& covariance);

}  // namespace zloam::odometry
