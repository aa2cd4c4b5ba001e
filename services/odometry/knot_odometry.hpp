#pragma once
// Odometry of a scan that comes in slices: of a 2-D scanner that a motor turns. The pose leaves with
// each slice, the points once the slices around them have settled where they are.

#include <deque>
#include <optional>

#include "common/geometry/fit_record.hpp"
#include "odometry/knot_window.hpp"

namespace zloam::odometry {

class KnotOdometry {
 public:
  KnotOdometry(const OdometryConfig& config, const Pose& T_base_lidar, const Pose& T_base_imu);

  /// Moves on by one slice; as Odometry::process. The clouds of the result are those of a whole turn
  /// that has settled, and empty in between.
  OdometryResult process(const FeatureSweep& sweep);
  void configure(const OdometryConfig& config);
  void reset();

 private:
  /// The points of a slice that is in the window.
  struct Kept {
    std::int64_t begin_ns = 0;
    std::int64_t end_ns = 0;
    std::int64_t stamp_ns = 0;
    PointVector edges, planes;  ///< frame lidar, at their own times
  };

  void begin(const FeatureSweep& sweep, const Pose& T_odom_base);
  Slice slice_of(const FeatureSweep& sweep) const;
  /// Enough of a second turn is there to be matched: a slice alone leaves directions open.
  bool settled() const { return seen_ > turn_ + turn_ / 2; }
  void found();
  void note_rest();
  void let_settle();
  PointVector placed(std::size_t k, PointSpan points, const Pose& T_odom_to) const;
  void fill_clouds(OdometryResult& result) const;
  Degeneracy weak_directions(const KnotSolution& solution) const;
  Health judge(const FeatureSweep& sweep, const KnotSolution& solution);

  OdometryConfig config_;
  Pose T_base_lidar_;
  Pose T_base_imu_;
  KnotWindow window_;
  std::optional<WindowMap> recent_;
  std::deque<Kept> kept_;
  /// of the slices before: the share of their points on surfaces
  FitRecord explained_;
  /// slices to a turn, and those since the target was founded
  std::size_t turn_ = 1;
  std::size_t seen_ = 0;
  std::int64_t end_ns_ = 0;
  std::uint64_t prev_sweep_ = 0;
  bool begun_ = false;
  int bad_in_row_ = 0;
};

}  // namespace zloam::odometry
