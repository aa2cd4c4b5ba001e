#pragma once
// Map and matcher together: takes sweeps, returns poses. Keeps the motion of the last sweep for the
// priors and adds every matched sweep to the map, deskewed with its own converged motion.

#include <cstdint>
#include <optional>
#include <vector>

#include "common/geometry/error_record.hpp"
#include "common/plane_map/config.hpp"
#include "common/plane_map/sweep_matcher.hpp"
#include "common/plane_map/sweep_points.hpp"
#include "common/plane_map/voxel_plane_map.hpp"

namespace zloam::plane_map {

enum class PredictionUse {
  /// Where the motion of the sweep before is known: both are weighted by their covariances for the
  /// start of the iteration, and only that motion counts as a prior. Odometry has used the same
  /// points, and its slow drift would enter the map.
  kBeside,
  kInstead,  ///< the prediction alone is start and prior
};

/// The sweep's motion as estimated elsewhere (odometry).
struct MotionPrediction {
  Pose T_map_base = Pose::Identity();
  std::uint32_t instant_ns = 0;  // of that pose, after the sweep's stamp
  Vector6 twist_per_s = Vector6::Zero();
  Matrix6 pose_covariance = Matrix6::Zero();   // right perturbation, m and rad
  Matrix6 twist_covariance = Matrix6::Zero();  // per second
  PredictionUse use = PredictionUse::kBeside;
};

enum class Outcome {
  kStarted,    ///< first usable sweep: it made the map
  kMatched,    ///< matched and inserted
  kPredicted,  ///< too few points or matches, or no solution: pose is the prediction, not inserted
};

struct ScanToMapResult {
  Outcome outcome = Outcome::kPredicted;
  Pose T_map_base_mid = Pose::Identity();  // at stamp + period / 2
  Pose T_map_base_end = Pose::Identity();  // at stamp + period
  Vector6 twist_per_s = Vector6::Zero();   // body twist, constant over the sweep
  /// Change of the twist within the sweep.
  Vector6 twist_change_per_s = Vector6::Zero();
  Matrix12 covariance = Matrix12::Zero();  // of T_map_base_mid (right perturbation) and twist_per_s
  /// time in the sweep at which the points saw the pose (common/geometry/motion_covariance.hpp)
  double seen_at = 0.0;
  Bend bend;  // errors of twist_change_per_s, per sweep
  Degeneracy degeneracy;
  double residual_rms_m = 0.0;  // of planes, see MatchResult
  double inlier_rms_m = 0.0;
  double matched_fraction = 0.0;
  double matched_weight = 0.0;    // sum of the robust weights of the matches
  double explained_weight = 0.0;  // see MatchResult
  double gate_m = 0.0;
  double prediction_error_m = 0.0;  // at the gate's range
  int iterations = 0;
  bool converged = false;
  std::size_t points = 0;   // of the sweep
  std::size_t tried = 0;    // those that were matched
  std::size_t matches = 0;  // those that met a surface of the map

  /// Pose at an instant after the stamp of this sweep of the given period, and its covariance.
  Pose at(std::uint32_t instant_ns, std::uint32_t period_ns) const;
  Matrix6 covariance_at(std::uint32_t instant_ns, std::uint32_t period_ns) const;
};

class ScanToMap {
 public:
  ScanToMap(const PlaneMapConfig& map, const MatcherConfig& matcher,
            const Pose& T_map_base_start = Pose::Identity());

  /// Takes sweeps in order of their stamps; one that is not later than its predecessor is treated
  /// as one period later.
  ScanToMapResult process(const SweepInput& sweep,
                          const std::optional<MotionPrediction>& prediction = std::nullopt);

  /// The two halves of process(). match() does not change map and motion and may be called several
  /// times for a sweep; commit() takes one of its results as the sweep's motion, and with `insert`
  /// adds the points to the map. Without a map, match() returns the prediction.
  ScanToMapResult match(const SweepInput& sweep,
                        const std::optional<MotionPrediction>& prediction = std::nullopt);
  void commit(const SweepInput& sweep, const ScanToMapResult& result, bool insert);

  /// After each() restored the state in which this sweep was committed: inserts its points at the
  /// same places again. False: the state is of another sweep.
  bool insert_again(const SweepInput& sweep);
  /// Motion of the sweep committed last, deskewing included; nothing after a gap.
  std::optional<ScanToMapResult> last_motion() const;

  /// The whole state but the map, to save or restore it.
  template <class Bits>
  void each(Bits& bits) {
    bits(previous_, acceleration_, gate_m_, share_, weak_, weak_axis_base_, sweeps_);
  }

  /// The next sweep does not continue the motion of the last one.
  void forget_motion() {
    previous_.reset();
    share_ = 0.0;
  }
  bool knows_motion() const { return previous_.has_value(); }

  /// Squared Mahalanobis distance (six degrees of freedom) between the poses that the prediction
  /// and the motion of the sweep before expect; 0 without such a motion.
  double disagreement(const SweepInput& sweep, const MotionPrediction& prediction) const;

  /// From the next sweep on.
  void configure(const MatcherConfig& matcher);

  VoxelPlaneMap& map() { return map_; }
  const VoxelPlaneMap& map() const { return map_; }

 private:
  struct Previous {
    SweepMotion motion;                      // grid frame
    Matrix12 covariance = Matrix12::Zero();  // of both, per sweep
    double seen_at = 0.0;
    Vector6 twist_change = Vector6::Zero();  // against the sweep before, per sweep
    std::int64_t stamp_ns = 0;
    std::uint32_t period_ns = 0;

    template <class Bits>
    void each(Bits& bits) {
      bits(motion, covariance, seen_at, twist_change, stamp_ns, period_ns);
    }
  };

  Vector6 previous_twist_per_s() const;
  Matrix12 bounded() const;
  Matrix12 carried_on(double steps, double rate) const;
  Matrix6 change(double steps) const;
  void remember(const SweepInput& sweep, const ScanToMapResult& result, const SweepMotion& motion);
  void learn_acceleration(const SweepInput& sweep, const ScanToMapResult& result,
                          const Matrix12& covariance);
  bool adjoins(const SweepInput& sweep) const;
  void foresee(const SweepInput& sweep, MotionPrior& prior) const;
  Matrix6 continuity() const;
  MotionPrior make_prior(const SweepInput& sweep,
                         const std::optional<MotionPrediction>& prediction) const;
  void add_prediction(const SweepInput& sweep, const MotionPrediction& prediction,
                      MotionPrior& prior) const;
  MatchResult match(const SweepPoints& points, const MotionPrior& prior);
  const SweepPoints& matched_points_of(const SweepInput& sweep);
  void insert(const SweepInput& sweep, const SweepMotion& motion);
  void follow_gate(const ScanToMapResult& result);
  ScanToMapResult result_of(const MatchResult& match, const SweepInput& sweep) const;

  MatcherConfig config_;
  VoxelPlaneMap map_;
  SweepMatcher matcher_;
  Pose T_grid_base_start_;
  std::optional<Previous> previous_;
  // Change of the twist, m/s^2 and rad/s^2: recent errors of predicting a sweep by the motion of
  // the sweep before, in addition to config_.change_sigma_*.
  ErrorRecord acceleration_{0.0, 0.0};
  SweepPoints matched_points_;                    // of the sweep that was matched last
  std::optional<std::int64_t> matched_stamp_ns_;  // until it is committed
  std::vector<SlotPoint> inserted_points_;
  std::vector<LocalPoint> inserted_;  // the same in the map's local coordinates
  double gate_m_;
  // Share of the normals along the least constrained direction, mean of the last sweeps. 0 after a
  // gap and in a restored map: prediction error unknown, the gate stays wide until the match is
  // well constrained again. No value in a map of one sweep, whose motion is continued.
  std::optional<double> share_ = 0.0;
  bool weak_ = false;
  Eigen::Vector3d weak_axis_base_ = Eigen::Vector3d::Zero();
  std::uint64_t sweeps_ = 0;
};

}  // namespace zloam::plane_map
