#pragma once
// Correspondences of one sweep with its target, and the solution of its motion.

#include <cstdint>
#include <vector>

#include "odometry/config.hpp"
#include "odometry/motion_solver.hpp"
#include "odometry/odometry.hpp"
#include "odometry/window_map.hpp"

namespace zloam::odometry {

/// A point to be matched: frame base_link at its own time.
struct SourcePoint {
  Eigen::Vector3d position;
  std::uint16_t bin;
};

struct Source {
  std::vector<SourcePoint> planes;  ///< by time

  /// common/geometry/motion_covariance.hpp
  bool sees_a_part() const;
};

struct Solution {
  MotionState state;
  Matrix12 covariance = Matrix12::Zero();
  NormalEquations data;  ///< of the residuals alone, at the last iteration
  std::uint32_t iterations = 0;
  std::uint32_t planes = 0;
  double residual_m = 0.0;
  /// time in the sweep at which the residuals saw the pose, relative to its middle
  /// (common/geometry/motion_covariance.hpp)
  double seen_at = 0.0;
  /// of prior and residuals; a point without a match counts as one far off: less is better
  double cost = 0.0;
  /// the prior's part of it: half the squared distance from the prediction, in sigmas
  double prior_cost = 0.0;
  /// cost of the residuals alone, per point of the source
  double fit = 0.0;
  /// the last step was below the limits
  bool converged = false;
  /// the solution is not where the sensor is
  bool astray = false;
  /// false: too few matches, state is the prior
  bool solved = false;
};

/// Chooses the points to match and moves them to base_link: an even subset of the less flat ones.
Source choose_source(const FeatureSweep& sweep, const Pose& T_base_lidar,
                     const OdometryConfig& config);

/// Iterates matching and Gauss-Newton steps from the initial state.
Solution match_sweep(const Source& source, const MotionState& initial, const MotionPrior& prior,
                     double range_noise_m, const OdometryConfig& config, WindowMap& recent);

/// The starts from which matching most likely converges to the true pose, at most `most`, the
/// likeliest first: by the prior and the points as they lie there. Ties keep their order.
std::vector<MotionState> likeliest(const Source& source, const std::vector<MotionState>& starts,
                                   std::size_t most, const MotionPrior& prior, double range_noise_m,
                                   const OdometryConfig& config, WindowMap& recent);

/// Finite and nearer than any sensor sees.
bool is_usable(const Point& point);
bool any_usable(PointSpan points);

}  // namespace zloam::odometry
