#include <algorithm>
#include <cmath>
#include <utility>

#include "common/geometry/unobserved_motion.hpp"
#include "mapping/bridging.hpp"
#include "mapping/mapper_state.hpp"
#include "mapping/pose_covariance.hpp"
#include "mapping/voxel_planes_method.hpp"

namespace zloam::mapping {
namespace {

// In a fixed map the sensor may have been carried away during a longer time without odometry: it is
// searched for.
constexpr double kWatched_s = 1.0;
// After a longer time without odometry, a map to be extended is fixed again and searched as a
// whole: the same as between two runs (runtime::kLongestSearch_ns).
constexpr double kCarriedAway_s = 3.0;
// A new odometry knows the motion of its first sweep only from the second one, and distorted sweeps
// must not enter the map: this many sweeps must be matched before one is inserted.
constexpr std::uint32_t kSettling = 3;
// An unmatched sweep with fewer points is reported as TooFewPoints, others as Predicted.
constexpr std::uint32_t kFewestPoints = 50;
// This many residuals above the limit in a row are not chance: a better place is searched for, and
// again after every kWorseAgain further ones.
constexpr std::uint32_t kWorse = 3, kWorseAgain = 5;

// Pose after a gap of seconds: a platform keeps its velocity and its yaw rate about the map's
// vertical axis, but a tilt does not grow. in_map_per_s holds only these two, in the map's axes.
Pose moved_on(const Pose& T_map_base, const Vector6& in_map_per_s, double time_s) {
  const Pose moved = exp_se3(time_s * in_map_per_s);
  Pose out = T_map_base;
  out.linear() = moved.linear() * T_map_base.linear();
  out.translation() += moved.translation();
  return out;
}

std::int64_t instant_of(const MappingInput& input) { return input.stamp_ns + input.instant_ns; }

std::vector<LayeredPoint> layered(const TileMap& tiles, const std::vector<TileId>& ids) {
  std::vector<LayeredPoint> points;
  for (const TileId& id : ids) {
    const std::optional<Tile> tile = tiles.tile(id);
    if (!tile) continue;
    for (const MapPoint& p : tile->points) points.push_back({p, id.layer});
  }
  return points;
}

}  // namespace

Prediction Mapper::State::predict(const MappingInput& input) {
  const bool new_frame = last && input.odom_epoch != last->odom_epoch;
  const double gap_s =
      last ? std::max(0.0, 1e-9 * static_cast<double>(instant_of(input) - last->instant_ns)) : 0.0;
  if (new_frame) {
    const Pose moved =
        moved_on(last->T_map_base, lately.in_map_per_s(), std::min(gap_s, kLongestGap_s));
    T_map_odom = normalised(moved * input.T_odom_base.inverse());
  }
  if (told) T_map_odom = normalised(*told * input.T_odom_base.inverse());
  const double unwatched_s = input.unwatched_s.value_or(gap_s);
  if (new_frame && unwatched_s > kCarriedAway_s) search_whole_map();
  if (new_frame || break_expected || told || (is_fixed() && unwatched_s > kWatched_s)) {
    // A pose given by the user is valid now, however long the motion was unobserved.
    unseen_s = told ? 0.0 : bridging ? unseen_s + gap_s : gap_s;
    agreement.reset();
    last_match = {};
    bridging = tiles.point_count() >= config.founding_points;
    bridged_sweeps = 0;
    const double drifted_s = unseen_s > kLongestGap_s ? 0.0 : unseen_s;
    if (lost) {
      relocalizer.reset();
    } else {
      relocalizer.expect(T_map_odom, area_of(config, drifted_s, 0));
    }
  }
  if (new_frame && bridging) settling = kSettling;
  break_expected = false;
  told.reset();
  Prediction prediction;
  prediction.T_map_base = normalised(T_map_odom * input.T_odom_base);
  prediction.covariance = bridging ? bridge_covariance(config, unseen_s)
                                   : prior_covariance(config, input.step_covariance);
  return prediction;
}

// A match that explains much of a sweep may still be the wrong one of two places that look alike.
// Signs of it: it contradicts the odometry, or sweep after sweep fits worse than before, and
// another place fits better.
bool Mapper::State::is_elsewhere(const MappingInput& input, const Match& match,
                                 const Prediction& prediction) {
  const std::uint32_t worse = policy.worse_in_row();
  const bool is_worse = worse >= kWorse && (worse - kWorse) % kWorseAgain == 0;
  if (!match.ok || (!is_worse && !contradicts(match, prediction))) return false;
  return lies_better_elsewhere(*method, input, match, tiles, config, policy.median_residual_m());
}

Match Mapper::State::align(const MappingInput& input, const Prediction& prediction) {
  if (!bridging && settling == 0) {
    Match match = method->match(input, prediction);
    if (input.slices > 1) return near_odometry(match, prediction);
    const bool astray = is_astray(match, fits) || is_elsewhere(input, match, prediction);
    if (match.ok && match.converged) fits.add(match.fit);
    if (!astray) return match;
    begin_search();
  }
  if (!is_fixed() || !bridging) return searched(input, prediction);
  return searched_everywhere(input, prediction);
}

// A full turn of slices comes once a second, and half of it may be unmapped: its fit tells little
// about whether the place is right. The odometry has followed each slice and reports when it is
// lost, so a match that contradicts it is rejected.
Match Mapper::State::near_odometry(Match match, const Prediction& prediction) {
  if (match.ok && contradicts(match, prediction)) {
    match.ok = false;
    match.T_map_base = prediction.T_map_base;
  }
  return match;
}

// A map that is extended stays as it is until the robot is found in it again. The relocalizer's
// walls are those of the map before it grew.
void Mapper::State::search_whole_map() {
  if (config.mode != MappingMode::kExtend || tiles.point_count() < config.founding_points) return;
  found_in_map = false;
  relocalizer = Relocalizer();
}

void Mapper::State::begin_search() {
  bridging = lost = true;
  bridged_sweeps = 0;
  agreement.reset();
  relocalizer.reset();
}

// Searches a whole fixed map, of which it is only known that the robot may be in it.
Match Mapper::State::searched_everywhere(const MappingInput& input, const Prediction& prediction) {
  Match match = relocalizer.look(*method, input, tiles);
  ++bridged_sweeps;
  if (match.ok) {
    bridging = lost = false;
    found_in_map = true;
    unseen_s = 0.0;
    relocalizer.reset();
    settling -= std::min(settling, 1U);
  } else {
    match.T_map_base = prediction.T_map_base;
    method->not_found();
  }
  return match;
}

Match Mapper::State::searched(const MappingInput& input, const Prediction& prediction) {
  Bridged found = bridge(*method, input, prediction, tiles, config, policy.median_residual_m(),
                         fits, unseen_s, bridged_sweeps, lost);
  Match& match = found.match;
  const Pose T_odom_map = input.T_odom_base * match.T_map_base.inverse();
  const bool agreed = match.ok && agreement.add(T_odom_map.inverse(), input.T_odom_base);
  if (!match.ok) agreement.reset();
  match.ok = match.ok && (found.sure || agreed);
  if (!match.ok) match.T_map_base = prediction.T_map_base;
  ++bridged_sweeps;
  bridging = !match.ok;
  lost = lost && bridging;
  if (match.ok) {
    unseen_s = 0.0;
  } else {
    method->not_found();
  }
  settling = match.ok ? settling - std::min(settling, 1U) : settling;
  return match;
}

Matrix6 Mapper::State::predicted_covariance(const MappingInput& input,
                                            const Prediction& prediction) const {
  if (bridging) return prediction.covariance;
  // The first pose defines the map's frame: only the prior's own sigmas count.
  if (!last) return prior_covariance(config, Matrix6::Zero());
  const Pose T_now_last = input.T_odom_base.inverse() * last->T_odom_base;
  return carried(last->covariance, T_now_last) + prediction.covariance;
}

// Change of the rotation within a sweep against the sweep before.
double Mapper::State::turn_change_rad(const MappingInput& input) const {
  if (!last) return 0.0;
  const Vector6 change_per_s = input.twist_per_s - last->twist_per_s;
  return 1e-9 * input.period_ns * change_per_s.tail<3>().norm();
}

void Mapper::State::judge(const MappingInput& input, const Match& match, MappingResult& result) {
  if (match.ok) unmatched = 0;
  const bool without_map = tiles.point_count() < config.founding_points;
  const bool founding = !match.ok && !bridging && without_map;
  if (without_map && is_fixed()) {
    result.health = Health::kLost;
    result.reason = "there is no map to find it in";
  } else if (match.ok && settling > 0) {
    // The sweep may be distorted, and its pose is then wrong too.
    result.health = Health::kBridging;
    result.reason = "a new odometry frame is still settling";
  } else if (match.ok) {
    result.health = match.degeneracy.degenerate ? Health::kDegenerate : Health::kOk;
    result.reason = policy.judge(match.T_map_base, match.residual_m);
    if (is_fixed()) result.reason = "the map stays as it is";
  } else if (bridging) {
    // Applies to a sweep without points as well: its pose in the map is unknown too.
    const bool given_up = bridged_sweeps > config.bridge_sweeps;
    result.health = lost || given_up ? Health::kLost : Health::kBridging;
    result.reason = lost ? "the sweep does not fit the map where it should be: searched for"
                         : "new odometry frame not yet matched";
  } else if (input.edges.empty() && input.planes.empty()) {
    result.health = Health::kEmpty;
    result.reason = "no point came";
  } else if (founding) {
    result.health = Health::kOk;
  } else {
    result.health = match.candidates < kFewestPoints ? Health::kTooFewPoints : Health::kPredicted;
    result.reason = "too few correspondences: predicted only";
    if (left_map(input)) {
      result.health = Health::kLost;
      result.reason = "the sweeps have met nothing of the map: searched for";
    }
  }
}

// After bridge_sweeps unmatched sweeps in a row the prediction no longer counts as a pose in the
// map: a fixed map ends somewhere, and an odometry of slices that is off contradicts each turn.
bool Mapper::State::left_map(const MappingInput& input) {
  if (!is_fixed() && input.slices <= 1) return false;
  if (++unmatched <= config.bridge_sweeps) return false;
  unmatched = 0;
  begin_search();
  return true;
}

void Mapper::State::insert(const MappingInput& input, const Match& match, MappingResult& result) {
  SubmapInput seen;
  seen.sweep = input.sweep;
  seen.instant_ns = instant_of(input);
  seen.T_map_base = result.T_map_base;
  seen.covariance = result.covariance;
  seen.found = result.health == Health::kOk || result.health == Health::kDegenerate;
  seen.degenerate = result.health == Health::kDegenerate;
  seen.range_noise_m = input.range_noise_m;
  seen.origin_base = input.T_base_lidar.translation();
  if (!result.reason.empty()) {
    result.submap = submaps.add(seen);
    return;
  }
  Match placed = match;
  placed.T_map_base = result.T_map_base;
  const InsertClouds clouds = method->insert(input, placed);
  put(clouds, placed.T_map_base);
  policy.inserted_at(placed.T_map_base);
  seen.edges = clouds.edges;
  seen.planes = clouds.planes;
  result.submap = submaps.add(seen);
  result.inserted = true;
  result.changed = tiles.take_changed();
}

void Mapper::State::put(const InsertClouds& clouds, const Pose& T_map_base) {
  tiles.insert(Layer::kEdge, clouds.edges, T_map_base);
  tiles.insert(Layer::kPlane, clouds.planes, T_map_base);
}

// Whether the odometry can be followed: no new frame, expected break or given pose is pending.
bool Mapper::State::goes_on(const MappingInput& input) const {
  const bool same_frame = last ? input.odom_epoch == last->odom_epoch : !is_fixed();
  return same_frame && !break_expected && !told;
}

// Result for a pose without points of its own: the last match continued by the odometry.
MappingResult Mapper::State::carry(const MappingInput& input) {
  MappingResult result;
  result.sweep = input.sweep;
  result.T_map_odom = T_map_odom;
  result.T_map_base = normalised(T_map_odom * input.T_odom_base);
  result.covariance = predicted_covariance(
      input, {result.T_map_base, bridging ? bridge_covariance(config, unseen_s)
                                          : sane_covariance(input.step_covariance)});
  result.health = carried_health(input);
  if (!bridging) result.degeneracy = last_match.degeneracy_at(input.T_odom_base);
  result.reason = "its points come with a later sweep";
  remember(input, result);
  return result;
}

// The pose is known no better than the last match and the odometry since then.
Health Mapper::State::carried_health(const MappingInput& input) const {
  if (bridging) return lost ? Health::kLost : Health::kBridging;
  const bool followed = input.health == Health::kOk || input.health == Health::kDegenerate;
  return followed && last_match.health != Health::kOk ? last_match.health : input.health;
}

void Mapper::State::remember(const MappingInput& input, const MappingResult& result) {
  last = LastPose{instant_of(input), input.odom_epoch,  result.T_map_base,
                  input.T_odom_base, input.twist_per_s, result.covariance};
  if (!bridging && settling == 0) lately.add(last->instant_ns, last->T_map_base);
  path.push_back({input.sweep, instant_of(input), result.T_map_base});
}

Mapper::Mapper(const MappingConfig& config)
    : state_(std::make_unique<State>(config, make_voxel_planes_method(config))) {}
Mapper::~Mapper() = default;
Mapper::Mapper(Mapper&&) noexcept = default;
Mapper& Mapper::operator=(Mapper&&) noexcept = default;

MappingResult Mapper::process(const MappingInput& input) {
  State& s = *state_;
  MappingResult result;
  result.sweep = input.sweep;
  if (!input.T_odom_base.matrix().allFinite() || !input.twist_per_s.allFinite()) {
    result.T_map_odom = s.T_map_odom;
    if (s.last) result.T_map_base = s.last->T_map_base;
    result.covariance = bridge_covariance(s.config, 0.0);
    result.health = Health::kInvalid;
    result.reason = "pose or twist not finite";
    return result;
  }
  s.go_on_from(input);
  if (input.points_follow() && s.goes_on(input)) return s.carry(input);
  const Prediction prediction = s.predict(input);
  result.evicted = s.tiles.follow(prediction.T_map_base.translation());
  const Match match = s.align(input, prediction);
  result.T_map_base = match.ok ? match.T_map_base : prediction.T_map_base;
  result.covariance =
      match.ok ? published_covariance(match.covariance, s.turn_change_rad(input), s.config)
               : s.predicted_covariance(input, prediction);
  result.degeneracy = match.degeneracy;
  result.iterations = match.iterations;
  result.correspondences = match.correspondences;
  result.residual_m = match.residual_m;
  s.T_map_odom = normalised(result.T_map_base * input.T_odom_base.inverse());
  result.T_map_odom = s.T_map_odom;
  s.judge(input, match, result);
  if (!input.points_follow()) {
    s.last_match = {result.health, result.degeneracy, input.T_odom_base};
  }
  s.insert(input, match, result);
  s.remember(input, result);
  return result;
}

void Mapper::configure(const MappingConfig& config) {
  state_->config = config;
  state_->policy.configure(config);
  state_->submaps.configure(config.submap_m);
  state_->method->configure(config);
}

void Mapper::reset() {
  State& s = *state_;
  s.method->reset();
  s = State(s.config, std::move(s.method));
}

void Mapper::expect_break() { state_->break_expected = true; }
void Mapper::new_run() { state_->submaps.new_run(); }

void Mapper::place(const Pose& T_map_base) {
  State& s = *state_;
  s.told = T_map_base;
  s.lost = false;
  s.search_whole_map();
  s.method->not_found();
}

std::vector<VoxelTile> Mapper::take_changed_voxels(double growth) {
  return state_->method->take_changed(growth);
}

std::optional<Submap> Mapper::finish_submap() { return state_->submaps.finish(); }
const Pose& Mapper::T_map_odom() const { return state_->T_map_odom; }
const std::vector<PathPose>& Mapper::path() const { return state_->path; }
std::optional<Tile> Mapper::tile(const TileId& id) const { return state_->tiles.tile(id); }
std::uint64_t Mapper::tile_count(const TileId& id) const { return state_->tiles.count(id); }
std::vector<TileId> Mapper::tiles() const { return state_->tiles.tiles(); }
std::size_t Mapper::point_count() const { return state_->tiles.point_count(); }

std::string Mapper::archive_fault() const {
  const TileArchive& archive = state_->tiles.archive();
  if (archive.unread_points() > 0) {
    return std::to_string(archive.unread_points()) +
           " points of the map can't be read back from a file in mapping.spill_directory";
  }
  if (state_->tiles.left_out() > 0) {
    return std::to_string(state_->tiles.left_out()) +
           " points are too far from the map's origin and not in the map: begin a new one "
           "(zloam reset mapping), or set larger mapping.leaf_edge_m and mapping.leaf_plane_m";
  }
  if (archive.spill_failed()) {
    return "mapping.spill_directory takes no more tiles: they stay in memory, which grows; make "
           "room "
           "there and start this stage again";
  }
  return {};
}

std::vector<LayeredPoint> Mapper::surround() const {
  return layered(state_->tiles, state_->tiles.local_tiles());
}

std::vector<LayeredPoint> Mapper::cloud() const {
  return layered(state_->tiles, state_->tiles.tiles());
}

std::vector<LayeredPoint> Mapper::tile_points(const TileId& id) const {
  return layered(state_->tiles, {id});
}

}  // namespace zloam::mapping
