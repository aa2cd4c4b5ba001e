#pragma once
// Odometry of a scan that arrives in slices, from a 2-D scanner that a motor rotates. The pose is
// published with each slice, the points once the knots of the slices around them have settled.

#include <cstdint>
#include <deque>
#include <optional>
#include <span>
#include <vector>

#include "common/geometry/fit_record.hpp"
#include "odometry/knot_window.hpp"

namespace zloam::odometry {

class KnotOdometry {
 public:
  KnotOdometry(const OdometryConfig& config, const Pose& T_base_lidar, const Pose& T_base_imu);

  /// Moves on by one slice; as Odometry::process. The clouds of the result are those of a whole
  /// revolution that has settled, and empty in between.
  OdometryResult process(const FeatureSweep& sweep);
  void configure(const OdometryConfig& config);
  void reset();

  /// The whole state but the points. Empty unless the slice ends a revolution, and always in the
  /// first revolutions. Its layout is private to this program.
  std::vector<std::uint64_t> state();
  /// Restores the state of another instance, with the slices that slice_at still has: continues
  /// bit-exactly if these include all of its target and window. False, and reset: another program's
  /// state, or too few slices.
  bool restore(std::span<const std::uint64_t> state, const SliceAt& slice_at);

 private:
  /// The points of a slice that is in the window.
  struct Kept {
    std::uint64_t sweep = 0;
    std::int64_t begin_ns = 0;
    std::int64_t end_ns = 0;
    std::int64_t stamp_ns = 0;
    PointVector edges, planes;  ///< frame lidar, at their own times
  };
  /// Pose of a slice that is a part of the target.
  struct Settled {
    std::uint64_t sweep = 0;
    std::int64_t begin_ns = 0;
    Pose T_odom_begin = Pose::Identity();
    Pose T_odom_end = Pose::Identity();

    template <class Bits>
    void each(Bits& bits) {
      bits(sweep, begin_ns, T_odom_begin, T_odom_end);
    }
  };
  /// Parameters with which a slice in the window was made.
  struct MadeWith {
    std::uint64_t sweep = 0;
    std::int64_t begin_ns = 0;
    Eigen::Vector3d rate_bias_radps = Eigen::Vector3d::Zero();
    bool with_inertia = true;

    template <class Bits>
    void each(Bits& bits) {
      bits(sweep, begin_ns, rate_bias_radps, with_inertia);
    }
  };

  template <class Bits>
  void each(Bits& bits, std::deque<MadeWith>& made_with);
  bool take_back(std::span<const std::uint64_t> state, const SliceAt& slice_at);
  bool is_sound(const std::deque<MadeWith>& made_with) const;
  bool settle_again(const SliceAt& slice_at);
  bool hold_again(const std::deque<MadeWith>& made_with, const SliceAt& slice_at);

  /// True after a gap, if time runs backwards, or if nothing has fitted for long.
  bool must_restart(const FeatureSweep& sweep) const;
  void begin(const FeatureSweep& sweep, const Pose& T_odom_base);
  /// Adds the slice to the window, placed as the motion so far predicts.
  void take(const FeatureSweep& sweep);
  /// Estimates the IMU's parameters in the first revolutions.
  void learn_inertia();
  KnotSolution solve(double range_noise_m);
  OdometryDiagnostics diagnostics(const KnotSolution& solution, const Pose& T_odom_predicted) const;
  void make_target();
  Slice slice_of(const FeatureSweep& sweep, const MadeWith& with) const;
  void keep(const FeatureSweep& sweep, std::int64_t begin_ns);
  bool ends_turn() const { return seen_ >= 2 * turn_ && seen_ % turn_ == 0; }
  /// Enough of a second revolution is there to be matched: a slice alone leaves directions open.
  bool settled() const { return seen_ > turn_ + turn_ / 2; }
  void found();
  void note_rest();
  void find_gravity();
  /// Compares with a solution without the IMU; an IMU that the points contradict is ignored.
  void judge_inertia(const KnotSolution& solution, double range_noise_m);
  bool believes_inertia() const;
  void let_settle();
  /// Adds slice k of the window to the target, as its knots are now.
  void settle(std::size_t k);
  std::size_t most_settled() const;
  void fill_clouds(OdometryResult& result) const;
  Degeneracy weak_directions(const KnotSolution& solution) const;
  Health judge(const FeatureSweep& sweep, const KnotSolution& solution);

  OdometryConfig config_;
  Pose T_base_lidar_;
  Pose T_base_imu_;
  KnotWindow window_;
  std::optional<WindowMap> recent_;
  std::deque<Kept> kept_;
  /// of the target, the oldest first
  std::deque<Settled> settled_;
  /// of the slices before: the share of their points on surfaces
  FitRecord explained_;
  /// share of about the last revolution's solutions that did not converge, 0 to 1
  double restless_ = 0.0;
  /// slices per revolution, and slices since the target was initialized
  std::size_t turn_ = 1;
  std::size_t seen_ = 0;
  double range_noise_m_ = 0.0;
  std::int64_t end_ns_ = 0;
  std::uint64_t prev_sweep_ = 0;
  bool begun_ = false;
  int bad_in_row_ = 0;
  /// revolutions that the IMU predicted wrongly
  std::uint32_t imu_contradictions_ = 0;
};

}  // namespace zloam::odometry
