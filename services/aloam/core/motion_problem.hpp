#pragma once
// A motion that Ceres improves, as A-LOAM sets it up: Huber loss of 0.1 m, the quaternion on its
// manifold, dense QR, at most 4 iterations.

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>

#include "common/geometry/se3.hpp"

namespace ceres {
class CostFunction;
}

namespace zloam::aloam {

/// A-LOAM only prints a warning below this; here a motion from fewer correspondences is rejected.
inline constexpr std::uint32_t kFewestCorrespondences = 10;

/// p_target = q p + t.
struct Motion {
  Eigen::Quaterniond q = Eigen::Quaterniond::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();

  static Motion of(const Pose& pose) {
    return {Eigen::Quaterniond(pose.linear()), pose.translation()};
  }
  Pose pose() const;
  /// Of a share of the time: slerp from none, and as much of the shift.
  Motion part(double share) const {
    return {Eigen::Quaterniond::Identity().slerp(share, q), share * t};
  }
  Eigen::Vector3d operator*(const Eigen::Vector3d& p) const { return q * p + t; }
};

struct Solved {
  std::uint32_t iterations = 0;
  /// root of the mean cost of a correspondence, m
  double residual_m = 0.0;
  /// false: there is no solution, and the motion is the one before
  bool usable = false;
};

class MotionProblem {
 public:
  /// Improves `motion`, which stays where it is until solve().
  explicit MotionProblem(Motion& motion);
  ~MotionProblem();
  MotionProblem(const MotionProblem&) = delete;
  MotionProblem& operator=(const MotionProblem&) = delete;

  /// Takes the cost function over.
  void add(ceres::CostFunction* cost);
  std::uint32_t correspondences() const { return correspondences_; }
  /// Without a solution, or with one that is not finite, the motion stays as before.
  Solved solve();

 private:
  struct State;
  Motion& motion_;
  std::uint32_t correspondences_ = 0;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::aloam
