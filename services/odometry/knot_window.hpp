#pragma once
// The motion over the last slices of a scan that covers the field of view only after many of them,
// from a 2-D scanner that a motor rotates: a knot at each slice's end, all solved together.
//
// Unknowns: T_k, base_link at the end of slice k; between two knots the motion is a constant twist,
// T(t) = T_{k-1} Exp(a Log(T_{k-1}^-1 T_k)), a in [0, 1].
//   plane       r = n . (T(t) p) - d, against planes of the slices that have left the window
//   smoothness  e = v_{k+1} - v_k, v_k = Log(T_{k-1}^-1 T_k) / dt_k: accelerations are bounded
//   inertia     instead of smoothness with an IMU: rotation from knot to knot is the gyroscope's,
//               up to its bias; mean velocities differ by the effect of gravity and the force
// The first knot is fixed. Gauss-Newton with Geman-McClure weights, as in motion_solver.hpp.
// Continuous-time estimation with knots: Bosse and Zlot, ICRA 2009; instead of knots, Zhang and
// Singh (RSS 2014) match the growing sweep with one constant twist.

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "odometry/config.hpp"
#include "odometry/imu_integration.hpp"
#include "odometry/motion_solver.hpp"
#include "odometry/odometry.hpp"
#include "odometry/window_map.hpp"

namespace zloam::odometry {

/// A point to be matched.
struct SlicePoint {
  Eigen::Vector3d position;  ///< frame base_link at its own time
  double part;               ///< 0 at the knot before, 1 at the slice's own
};

/// From the end of the slice before to its own end.
struct Slice {
  double period_s = 0.1;
  std::vector<SlicePoint> points;
  std::optional<SweepInertia> inertia;
  /// gyroscope bias with which the slice was integrated
  Eigen::Vector3d rate_bias_radps = Eigen::Vector3d::Zero();
};

/// What is known of gravity and of the gyroscope's bias.
struct KnotInertia {
  Eigen::Vector3d gravity_mps2 = Eigen::Vector3d::Zero();  ///< frame odom; zero: not known yet
  Eigen::Vector3d rate_bias_radps = Eigen::Vector3d::Zero();
  /// one sigma of their drift until the next slice
  double gravity_sigma_mps2 = 0.02;
  double rate_bias_sigma_radps = 2e-4;

  template <class Bits>
  void each(Bits& bits) {
    bits(gravity_mps2, rate_bias_radps, gravity_sigma_mps2, rate_bias_sigma_radps);
  }
};

struct KnotSolution {
  std::uint32_t iterations = 0;
  std::uint32_t matched = 0;
  double residual_m = 0.0;
  /// of the points of the newest half: the share that lies on a surface, 0 to 1
  double explained = 0.0;
  bool converged = false;
  /// false: too few matches; the knots are as they were
  bool solved = false;
  /// of the last step, tangent at base_link
  Matrix6 covariance = Matrix6::Zero();
  /// of the residuals alone, as if the window were rigid: T at the last knot
  NormalEquations data;
};

class KnotWindow {
 public:
  explicit KnotWindow(const OdometryConfig& config) : config_(config) {}

  /// Restarts from this pose, most likely at rest.
  void begin(const Pose& T_odom_base);
  /// Adds a slice; its knot is predicted from the motion so far, or by the IMU.
  void push(Slice slice);
  /// The oldest slice leaves; its end is the first knot from then on.
  void pop();

  /// knots()[k] is at the begin, knots()[k + 1] at the end of slices()[k].
  const std::deque<Pose>& knots() const { return knots_; }
  const std::deque<Slice>& slices() const { return slices_; }

  /// Matches and solves until the steps are small.
  KnotSolution solve(WindowMap& target, double range_noise_m);

  /// The whole state but the slices, to save or restore it; after restoring call hold().
  template <class Bits>
  void each(Bits& bits) {
    bits(knots_, velocity_before_, velocity_before_sigma_, period_before_s_, inertia_before_,
         inertia_);
  }
  /// The slices between the restored knots: one fewer than these.
  void hold(std::deque<Slice> slices) { slices_ = std::move(slices); }

  /// Mean twist of a slice, m/s and rad/s.
  Vector6 velocity(std::size_t k) const;
  void configure(const OdometryConfig& config) { config_ = config; }
  /// A copy that has no inertial sensor.
  KnotWindow without_inertia() const;
  /// Without gravity the force says nothing about the motion.
  bool knows_gravity() const { return !inertia_.gravity_mps2.isZero(); }
  KnotInertia& inertia() { return inertia_; }
  const KnotInertia& inertia() const { return inertia_; }

 private:
  struct System;
  struct Match;

  std::vector<Match> match(WindowMap& target, double gate_m) const;
  double explained_of_newest(const std::vector<Match>& matches, double kernel_m) const;
  void add_points(const std::vector<Match>& matches, double weight, double kernel_m, System& system,
                  NormalEquations& data) const;
  void add_smoothness(std::size_t k, System& system) const;
  void add_turn(std::size_t k, System& system) const;
  void add_force(std::size_t k, System& system) const;
  void add_motion(const KnotInertia& before, System& system) const;
  void move(const Eigen::VectorXd& step);
  Matrix6 last_step_covariance(const System& system,
                               const Eigen::LDLT<Eigen::MatrixXd>& ldlt) const;

  OdometryConfig config_;
  std::deque<Pose> knots_;
  std::deque<Slice> slices_;
  /// of the slice that left last
  Vector6 velocity_before_ = Vector6::Zero();
  /// of the velocity, in addition to that from accelerations: only at the start
  Vector6 velocity_before_sigma_ = Vector6::Zero();
  double period_before_s_ = 0.1;
  std::optional<SweepInertia> inertia_before_;
  KnotInertia inertia_;
};

}  // namespace zloam::odometry
