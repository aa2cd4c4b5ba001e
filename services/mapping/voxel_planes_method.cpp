#include "mapping/voxel_planes_method.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>

#include "common/containers/thinning.hpp"
#include "common/geometry/deskew.hpp"
#include "common/geometry/health.hpp"
#include "common/plane_map/scan_to_map.hpp"
#include "mapping/voxel_tiles.hpp"

namespace zloam::mapping {
namespace {

// Lower limit of the range noise: a sweep that states less does not know it.
constexpr double kLeastNoise_m = 1e-3;
// 95 % of the odometry's steps at rest are below: chi-squared with six degrees of freedom.
constexpr double kRestChiSquared = 12.59;
// In periods of a sweep. The motion of the last mapped sweep still predicts the next one across one
// missing sweep; across several its prediction is metres off.
constexpr double kLongestStep = 2.5;
// Only a sweep without points may have a shorter period, or none.
constexpr std::uint32_t kLeastPeriod_ns = 1'000'000;
// Limit of the squared Mahalanobis distance between two predictions: 99.9 % are below if both
// covariances are right (chi-squared with six degrees of freedom).
constexpr double kContradiction = 22.46;
// Ratio of matched weights below which neither match is better: both starts led to the same place,
// or to two places that cannot be told apart.
constexpr double kBetterFit = 1.02;

// Whether the odometry's step is larger than its noise. On poorly constrained ground (a flat yard)
// it drifts by centimetres per sweep at rest, and the map would continue that as its first motion.
bool is_moving(const MappingInput& input) {
  const Vector6 step = 1e-9 * input.period_ns * input.twist_per_s;
  const Eigen::LDLT<Matrix6> covariance(input.step_covariance);
  const bool known = input.step_covariance.allFinite() && covariance.isPositive() &&
                     covariance.vectorD().minCoeff() > 0.0;
  return !known || step.dot(covariance.solve(step)) > kRestChiSquared;
}

/// As an empty cloud of a recording may be (messages/ranges.cpp): over no time at all, a motion has
/// neither a rate nor a covariance.
bool is_without_time(const MappingInput& input) {
  return input.period_ns < kLeastPeriod_ns && input.edges.empty() && input.planes.empty();
}

plane_map::SweepInput sweep_of(const MappingInput& input) {
  plane_map::SweepInput sweep;
  sweep.points = input.edges;
  sweep.more_points = input.planes;
  sweep.stamp_ns = input.stamp_ns;
  sweep.period_ns = input.period_ns;
  sweep.deskewed = plane_map::Deskewing{input.twist_per_s, input.instant_ns};
  sweep.inertial = input.inertial;
  return sweep;
}

class VoxelPlanesMethod : public MappingMethod {
 public:
  explicit VoxelPlanesMethod(const MappingConfig& config)
      : VoxelPlanesMethod(config.voxel_planes, config.drift_limit) {}

  Match match(const MappingInput& input, const Prediction& prediction) override;
  Match accept(const MappingInput& input, const Prediction& prediction) override;
  InsertClouds insert(const MappingInput& input, const Match& match) override;
  void not_found() override {
    if (scan_to_map_) scan_to_map_->forget_motion();
    open_.reset();
  }
  void reset() override { *this = VoxelPlanesMethod(config_, drift_limit_); }
  void configure(const MappingConfig& config) override {
    config_ = config.voxel_planes;
    drift_limit_ = config.drift_limit;
    if (scan_to_map_) scan_to_map_->configure(config_.matcher);
  }
  std::vector<VoxelTile> take_changed(double growth) override;
  void restore(const std::vector<VoxelTile>& tiles) override;
  bool each(StateBits& bits) override;
  void prepare(const MappingInput& input, const Pose& T_map_base) override;
  InsertClouds insert_again(const MappingInput& input, const Match& match) override;

 private:
  VoxelPlanesMethod(const VoxelPlanesConfig& config, double drift_limit)
      : config_(config), drift_limit_(drift_limit) {}

  // Result of one match of the current sweep, and its pose at the sweep's instant.
  struct Tried {
    plane_map::ScanToMapResult result;
    Pose T_map_base = Pose::Identity();
  };
  // The initial sweep, inserted while its motion was unknown: it is re-inserted with the motion of
  // the second sweep.
  struct Founding {
    PointVector points;
    Pose T_map_base = Pose::Identity();
    MappingInput info;
  };

  void begin(const MappingInput& input, const Prediction& prediction);
  InsertClouds tile_clouds(const MappingInput& input, const Vector6& twist_per_s);
  void found_anew(const MappingInput& input);
  void learn(const MappingInput& input, const Pose& T_map_base);
  plane_map::MotionPrediction advice(const MappingInput& input, const Prediction& prediction) const;
  plane_map::ScanToMapResult registered(const MappingInput& input, const Prediction& prediction);
  plane_map::ScanToMapResult placed_at(const MappingInput& input, const Pose& T_map_base) const;
  Degeneracy judged(const plane_map::Degeneracy& d, const Eigen::Matrix3d& R_base_mid) const;
  static PointSpan thinned(PointSpan points, const Thinning& thinning, const DeskewTable& table,
                           PointVector& out);

  VoxelPlanesConfig config_;
  double drift_limit_;
  std::optional<plane_map::ScanToMap> scan_to_map_;
  // Recent errors of the odometry's steps, m/s and rad/s.
  ErrorRecord odometry_error_{0.0, 0.0};
  Pose T_map_base_predicted_ = Pose::Identity();
  std::optional<MappingInput> open_;  // sweep of tried_, not yet committed; its spans are invalid
  std::vector<Tried> tried_;
  std::optional<Founding> founding_;
  std::uint32_t odom_epoch_ = 0;
  std::optional<std::int64_t> last_stamp_ns_;
  PointVector tile_edges_, tile_planes_;
  VoxelTiles tiles_;
};

plane_map::MotionPrediction VoxelPlanesMethod::advice(const MappingInput& input,
                                                      const Prediction& prediction) const {
  plane_map::MotionPrediction out;
  out.T_map_base = prediction.T_map_base;
  out.instant_ns = input.instant_ns;
  out.twist_per_s = input.twist_per_s;
  out.pose_covariance = prediction.covariance;
  const double step_s = 1e-9 * input.period_ns;
  out.pose_covariance += step_s * step_s * odometry_error_.covariance();
  return out;
}

// Matches from two predictions of the motion, the odometry's and that of the sweeps mapped before,
// each weighted by its recent errors. If they contradict each other, one of them is wrong and their
// mean is useless: the sweep is then matched from each, and the better fit counts.
plane_map::ScanToMapResult VoxelPlanesMethod::registered(const MappingInput& input,
                                                         const Prediction& prediction) {
  const plane_map::SweepInput sweep = sweep_of(input);
  plane_map::MotionPrediction odometry = advice(input, prediction);
  if (!scan_to_map_->knows_motion()) return scan_to_map_->match(sweep, odometry);
  if (scan_to_map_->disagreement(sweep, odometry) <= kContradiction) {
    return input.degenerate ? scan_to_map_->match(sweep) : scan_to_map_->match(sweep, odometry);
  }
  const auto own = scan_to_map_->match(sweep);
  odometry.use = plane_map::PredictionUse::kInstead;
  const double per_s = 1e9 / std::max<double>(input.period_ns, 1.0);
  const double v = per_s * config_.matcher.change_sigma_m;
  const double w = per_s * config_.matcher.change_sigma_rad;
  odometry.twist_covariance.diagonal() << v * v, v * v, v * v, w * w, w * w, w * w;
  const auto by_odometry = scan_to_map_->match(sweep, odometry);
  return by_odometry.matched_weight > kBetterFit * own.matched_weight ? by_odometry : own;
}

// The result that a match would have at this pose, with the odometry's twist.
plane_map::ScanToMapResult VoxelPlanesMethod::placed_at(const MappingInput& input,
                                                        const Pose& T_map_base) const {
  plane_map::ScanToMapResult result;
  const double to_mid_s = 0.5e-9 * input.period_ns - 1e-9 * input.instant_ns;
  result.twist_per_s = input.twist_per_s;
  result.T_map_base_mid = normalised(T_map_base * exp_se3(to_mid_s * input.twist_per_s));
  return result;
}

// Odometry publishes its first sweep before it knows the motion, so that the sweep is distorted by
// half a metre at 5 m/s. It is re-inserted into an empty map with the second sweep's motion.
void VoxelPlanesMethod::found_anew(const MappingInput& input) {
  const Founding founding = std::move(*founding_);
  plane_map::PlaneMapConfig map = scan_to_map_->map().config();
  scan_to_map_.emplace(map, config_.matcher, founding.T_map_base);
  MappingInput first = founding.info;
  first.edges = {};
  first.planes = founding.points;
  const plane_map::SweepInput sweep = sweep_of(first);
  first.twist_per_s = input.twist_per_s;
  const auto result = placed_at(first, founding.T_map_base);
  scan_to_map_->commit(sweep, result, true);
}

void VoxelPlanesMethod::prepare(const MappingInput& input, const Pose& T_map_base) {
  if (scan_to_map_) return;
  plane_map::PlaneMapConfig map = config_.map;
  map.range_noise_m = std::max(input.range_noise_m, kLeastNoise_m);
  scan_to_map_.emplace(map, config_.matcher, T_map_base);
  tiles_.load_into(scan_to_map_->map());
  odom_epoch_ = input.odom_epoch;
}

bool VoxelPlanesMethod::each(StateBits& bits) {
  if (!scan_to_map_ || open_ || founding_) return false;
  bits(*scan_to_map_, odometry_error_, odom_epoch_, last_stamp_ns_);
  return true;
}

void VoxelPlanesMethod::begin(const MappingInput& input, const Prediction& prediction) {
  if (!scan_to_map_) {
    prepare(input, prediction.T_map_base);
  } else if (open_ && tried_.size() == 1) {
    // The sweep before was matched but not inserted.
    scan_to_map_->commit(sweep_of(*open_), tried_.front().result, false);
  }
  if (founding_ && !input.twist_per_s.isZero(0.0)) {
    if (is_moving(input)) found_anew(input);
    founding_.reset();
  }
  const bool bridged = open_ && tried_.size() > 1;
  // Odometry processed the sweeps that are missing here: after a gap only its motion is valid.
  const bool gap = last_stamp_ns_ && static_cast<double>(input.stamp_ns - *last_stamp_ns_) >
                                         kLongestStep * input.period_ns;
  if (bridged || gap || input.odom_epoch != odom_epoch_) scan_to_map_->forget_motion();
  odom_epoch_ = input.odom_epoch;
  last_stamp_ns_ = input.stamp_ns;
  tried_.clear();
  open_ = input;
}

// A direction is degenerate if the points alone leave a sigma above the limit, or if their share of
// information along it is no more than errors of the normals may produce: with such a share two of
// five poses of random drives were silently wrong
// (docs/experiments/2026-11-29-starts-and-shares.md).
Degeneracy VoxelPlanesMethod::judged(const plane_map::Degeneracy& d,
                                     const Eigen::Matrix3d& R_base_mid) const {
  const double pretended = std::pow(config_.matcher.weak_least_cosine, 2);
  const double measured_m = d.share < pretended ? plane_map::kNothingKnown_m : d.measured_sigma_m;
  const bool weak_translation = measured_m > drift_limit_ * kJudgedWay_m;
  const bool weak_rotation = d.measured_sigma_rad > drift_limit_;
  const bool in_rad = weak_rotation && !weak_translation;
  Degeneracy out;
  out.degenerate = weak_translation || weak_rotation;
  if (weak_translation) out.weak_translation = R_base_mid * d.axis;
  if (weak_rotation) out.weak_rotation = R_base_mid * d.rotation_axis;
  out.sigma_measured = in_rad ? d.measured_sigma_rad : measured_m;
  out.sigma_predicted = in_rad ? d.predicted_sigma_rad : d.predicted_sigma_m;
  out.share = d.share;
  return out;
}

Match VoxelPlanesMethod::match(const MappingInput& input, const Prediction& prediction) {
  Match match;
  match.T_map_base = prediction.T_map_base;
  // The motion before it remains the one that predicts the next sweep.
  if (is_without_time(input)) return match;
  const bool same = open_ && open_->sweep == input.sweep && open_->stamp_ns == input.stamp_ns;
  if (!same) begin(input, prediction);
  T_map_base_predicted_ = prediction.T_map_base;
  const auto result = registered(input, prediction);
  match.candidates = static_cast<std::uint32_t>(result.tried);
  if (result.outcome != plane_map::Outcome::kMatched) {
    tried_.push_back({placed_at(input, prediction.T_map_base), match.T_map_base});
    return match;
  }
  match.T_map_base = result.at(input.instant_ns, input.period_ns);
  match.covariance = result.covariance_at(input.instant_ns, input.period_ns);
  match.ok = match.T_map_base.matrix().allFinite() && match.covariance.allFinite();
  match.iterations = static_cast<std::uint32_t>(result.iterations);
  match.correspondences = static_cast<std::uint32_t>(result.matches);
  match.inliers = match.correspondences;
  match.converged = result.converged;
  match.fit = result.matched_weight / std::max<double>(1.0, static_cast<double>(result.tried));
  match.explained =
      result.explained_weight / std::max<double>(1.0, static_cast<double>(result.tried));
  match.residual_m = result.residual_rms_m;
  match.inlier_residual_m = result.inlier_rms_m;
  const plane_map::Degeneracy& d = result.degeneracy;
  const Eigen::Matrix3d R_base_mid =
      match.T_map_base.linear().transpose() * result.T_map_base_mid.linear();
  match.degeneracy = judged(d, R_base_mid);
  tried_.push_back({result, match.T_map_base});
  return match;
}

Match VoxelPlanesMethod::accept(const MappingInput& input, const Prediction& prediction) {
  begin(input, prediction);
  Match match;
  match.ok = true;
  match.T_map_base = prediction.T_map_base;
  match.covariance = prediction.covariance;
  return match;
}

// Records the error of the odometry's step since the sweep mapped before.
void VoxelPlanesMethod::learn(const MappingInput& input, const Pose& T_map_base) {
  const double step_s = 1e-9 * input.period_ns;
  odometry_error_.add(log_se3(T_map_base_predicted_.inverse() * T_map_base) / step_s);
}

InsertClouds VoxelPlanesMethod::insert(const MappingInput& input, const Match& match) {
  plane_map::ScanToMapResult result = placed_at(input, match.T_map_base);
  for (const Tried& t : tried_) {
    if (t.T_map_base.matrix() == match.T_map_base.matrix()) result = t.result;
  }
  if (scan_to_map_->map().empty() && input.twist_per_s.isZero(0.0)) {
    PointVector points(input.edges.begin(), input.edges.end());
    points.insert(points.end(), input.planes.begin(), input.planes.end());
    founding_ = Founding{std::move(points), match.T_map_base, input};
  }
  if (scan_to_map_->knows_motion() && tried_.size() == 1) learn(input, match.T_map_base);
  scan_to_map_->commit(sweep_of(input), result, true);
  open_.reset();
  return tile_clouds(input, result.twist_per_s);
}

InsertClouds VoxelPlanesMethod::insert_again(const MappingInput& input, const Match& match) {
  const auto motion = scan_to_map_ ? scan_to_map_->last_motion() : std::nullopt;
  if (motion && scan_to_map_->insert_again(sweep_of(input))) {
    return tile_clouds(input, motion->twist_per_s);
  }
  accept(input, {match.T_map_base, match.covariance});
  return insert(input, match);
}

// Points for the tiles, deskewed with the motion that mapping estimated instead of the odometry's.
InsertClouds VoxelPlanesMethod::tile_clouds(const MappingInput& input, const Vector6& twist_per_s) {
  const DeskewTable odometry(input.twist_per_s, input.period_ns, input.instant_ns);
  const DeskewTable own(twist_per_s, input.period_ns, input.instant_ns);
  const DeskewTable table = own.in_place_of(odometry);
  const std::size_t stride = std::max(config_.tile_stride, 1U);
  const std::size_t enough = stride_to(config_.enough_tile_points, input.planes.size());
  return {thinned(input.edges, {stride, input.sweep}, table, tile_edges_),
          thinned(input.planes, {std::max(stride, enough), input.sweep}, table, tile_planes_)};
}

std::vector<VoxelTile> VoxelPlanesMethod::take_changed(double growth) {
  if (!scan_to_map_) return {};
  return tiles_.take_changed(scan_to_map_->map(), growth);
}

void VoxelPlanesMethod::restore(const std::vector<VoxelTile>& tiles) {
  tiles_.keep_for_loading(tiles);
}

// The points that remain after thinning, deskewed by the table.
PointSpan VoxelPlanesMethod::thinned(PointSpan points, const Thinning& thinning,
                                     const DeskewTable& table, PointVector& out) {
  out.clear();
  thinning.each(points, [&](Point p) {
    const Eigen::Vector3f moved =
        (table.motion_at(p.time_ns) * p.position().cast<double>()).cast<float>();
    p.x = moved.x();
    p.y = moved.y();
    p.z = moved.z();
    out.push_back(p);
  });
  return out;
}

}  // namespace

std::unique_ptr<MappingMethod> make_voxel_planes_method(const MappingConfig& config) {
  return std::make_unique<VoxelPlanesMethod>(config);
}

}  // namespace zloam::mapping
