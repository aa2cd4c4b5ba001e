#pragma once
// The platform's own motion, as the published poses show it: from one step to the next a mass
// changes its velocity little, and by how much is seen while it moves. A step that differs by more
// from the one before is a sudden acceleration or an error of the pose. It is the only thing that
// can be said of the first poses of a drive, where no other measurement has a record yet.

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "common/geometry/error_record.hpp"
#include "common/geometry/se3.hpp"

namespace zloam::integration {

class OwnMotion {
 public:
  /// Takes the poses as they are published. Returns by how much this pose's step differs from the
  /// motion before, in the pose's axes, if neither the changes of velocity so far nor the
  /// covariances of the two poses explain it; else zero. The first step that is seen is compared
  /// with rest, and the one after a discontinuity with nothing.
  Eigen::Vector3d unexplained_m(std::int64_t instant_ns, const Pose& T_map_base,
                                const Matrix6& covariance);
  /// The next pose does not follow the last one; how the platform moves is not known. Before its
  /// first step it is still expected to be at rest.
  void forget_motion();
  /// The next pose is not the beginning: the platform may be in motion.
  void begun_before();

  template <class Bits>
  void each(Bits& bits) {
    bits(last_, velocity_mps_, begins_, accelerations_);
  }

 private:
  struct Last {
    std::int64_t instant_ns = 0;
    Pose T_map_base = Pose::Identity();
    Eigen::Matrix3d covariance_m2 = Eigen::Matrix3d::Zero();

    template <class Bits>
    void each(Bits& bits) {
      bits(instant_ns, T_map_base, covariance_m2);
    }
  };
  /// Takes the change of velocity over a step for one that the platform can make.
  void learn(const Eigen::Vector3d& change_mps, double over_s, bool begins);

  std::optional<Last> last_;
  /// at the last pose, in its axes
  std::optional<Eigen::Vector3d> velocity_mps_;
  /// no step yet
  bool begins_ = true;
  /// translation only, m/s²
  ErrorRecord accelerations_{0.0, 0.0};
};

}  // namespace zloam::integration
