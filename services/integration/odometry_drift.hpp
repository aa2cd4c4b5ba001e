#pragma once
// How far odometry and map have come apart over the last metres. Points that move with the sensor
// (a crowd, a part of its own platform) take the odometry along slowly, and no single step
// contradicts the map's.

#include <Eigen/Core>
#include <deque>
#include <optional>

#include "common/geometry/se3.hpp"

namespace zloam::integration {

class OdometryDrift {
 public:
  /// Takes the poses that the map has measured in all directions, in order. Position covariance in
  /// the pose's axes, m².
  void add(const Pose& T_map_base, const Pose& T_odom_base, const Eigen::Matrix3d& covariance_m2);
  /// The next pose does not follow the last one, in the map or in the odometry's frame.
  void forget();

  /// Distance between the two displacements over way_m().
  double drift_m() const;
  /// Way of the map's poses that the drift came about on: the last ten metres, or fewer.
  double way_m() const;
  /// Whether it is more than limit_m and what the map's covariances explain (three sigmas).
  bool exceeds(double limit_m) const;

  template <class Bits>
  void each(Bits& bits) {
    bits(kept_, last_);
  }

 private:
  struct Place {
    Pose T_map_base = Pose::Identity();
    Pose T_odom_base = Pose::Identity();
    double variance_m2 = 0.0;
    /// of the map since the first place, m
    double way_m = 0.0;

    template <class Bits>
    void each(Bits& bits) {
      bits(T_map_base, T_odom_base, variance_m2, way_m);
    }
  };

  /// From the place that the last one is compared with; not empty if there is a last one.
  std::deque<Place> kept_;
  std::optional<Place> last_;
};

}  // namespace zloam::integration
