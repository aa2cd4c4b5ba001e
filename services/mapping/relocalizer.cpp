#include "mapping/relocalizer.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "mapping/bridging.hpp"
#include "mapping/tile_map.hpp"
#include "mapping/voxel_filter.hpp"

namespace zloam::mapping {
namespace {

// The surroundings compared with the map: of the last kSweepsSeen sweeps one point per voxel each.
constexpr std::size_t kSweepsSeen = 30;
constexpr double kLeaf_m = 0.3;
// Time between two searches of the map; it doubles up to the longest while there is no hypothesis.
constexpr std::int64_t kLook_ns = 500'000'000, kLongestLook_ns = 2'000'000'000;
constexpr std::size_t kMostPlaces = 16, kMostExpected = 8, kMostHypotheses = 32;
// Number of hypotheses that are matched with the sweeps between two searches.
constexpr std::size_t kFollowed = 3;
// Error of a place found by the search, one sigma.
constexpr double kStart_m = 0.5, kStart_rad = 0.05;
// Poses closer than this are the same place.
constexpr double kSame_m = 0.5, kSame_rad = 0.05;
// Minimum explained share of a sweep for a hypothesis.
constexpr double kLeastLikeness = 0.15;
// Conditions of accepting a place (docs/experiments/2026-11-27-kidnapped.md): minimum number of
// matched sweeps, distance and likeness, and maximum likeness of any other place relative to it.
constexpr int kLooks = 3;
constexpr double kWay_m = 1.0;
constexpr double kLikeness = 0.3, kUnique = 0.9;
// Before a place is accepted, all places that match at least this share of its walls are tested; if
// there are kTooMany, they cannot be told apart.
constexpr double kAlike = 0.85;
constexpr std::size_t kTooMany = 48;

Match matched(MappingMethod& method, const MappingInput& input, const Pose& T_map_base) {
  Matrix6 covariance = Matrix6::Zero();
  covariance.diagonal().head<3>().setConstant(kStart_m * kStart_m);
  covariance.diagonal().tail<3>().setConstant(kStart_rad * kStart_rad);
  return matched_from_afar(method, input, {T_map_base, covariance});
}

bool is_same(const Pose& a, const Pose& b) {
  const Pose apart = a.inverse() * b;
  return apart.translation().norm() < kSame_m &&
         Eigen::AngleAxisd(apart.linear()).angle() < kSame_rad;
}

WallMap walls_of(const TileMap& tiles) {
  std::vector<Eigen::Vector3f> points;
  for (const TileId& id : tiles.tiles()) {
    const std::optional<Tile> tile = tiles.tile(id);
    if (!tile) continue;
    for (const MapPoint& p : tile->points) points.emplace_back(p.x, p.y, p.z);
  }
  return WallMap(points);
}

/// Level frame at the robot's position: it has the axes of odom.
Pose level_at(const MappingInput& input) {
  Pose T_odom_level = Pose::Identity();
  T_odom_level.translation() = input.T_odom_base.translation();
  return T_odom_level;
}

}  // namespace

double Relocalizer::Hypothesis::likeness() const {
  return explained / looks * (1.0 - seen_through / looks);
}

void Relocalizer::reset() {
  seen_.clear();
  hypotheses_.clear();
  expected_.reset();
  looked_ns_.reset();
  wait_ns_ = kLook_ns;
}

void Relocalizer::expect(const Pose& T_map_odom, const SearchArea& area) {
  reset();
  expected_ = {T_map_odom, area};
}

bool Relocalizer::is_expected(const Pose& T_map_base, const MappingInput& input) const {
  if (!expected_) return false;
  const Pose apart = (expected_->T_map_odom * input.T_odom_base).inverse() * T_map_base;
  return apart.translation().norm() < expected_->area.distance_m + kSame_m &&
         Eigen::AngleAxisd(apart.linear()).angle() < expected_->area.rotation_rad + kSame_rad;
}

void Relocalizer::see(const MappingInput& input) {
  std::vector<Eigen::Vector3d> points;
  for (const PointSpan layer : {input.edges, input.planes}) {
    for (const Eigen::Vector3d& p : voxel_means(layer, kLeaf_m)) {
      points.push_back(input.T_odom_base * p);
    }
  }
  seen_.push_back(std::move(points));
  if (seen_.size() > kSweepsSeen) seen_.pop_front();
}

Surroundings Relocalizer::surroundings(const MappingInput& input) const {
  const Eigen::Vector3d here = input.T_odom_base.translation();
  std::vector<Eigen::Vector3f> points_level;
  for (const auto& sweep : seen_) {
    for (const Eigen::Vector3d& p : sweep) points_level.emplace_back((p - here).cast<float>());
  }
  return Surroundings(points_level);
}

void Relocalizer::follow(MappingMethod& method, const MappingInput& input, const SweepView& view,
                         std::size_t most) {
  std::size_t followed = 0;
  std::erase_if(hypotheses_, [&](Hypothesis& h) {
    if (followed++ >= most) return false;
    const Pose led_to = normalised(h.T_map_odom * input.T_odom_base);
    h.match = matched(method, input, led_to);
    if (!h.match.ok || h.match.explained < kLeastLikeness || !is_same(led_to, h.match.T_map_base)) {
      return true;
    }
    h.T_map_odom = normalised(h.match.T_map_base * input.T_odom_base.inverse());
    h.explained += h.match.explained;
    h.seen_through += map_->seen_through(view, h.match.T_map_base * input.T_base_lidar);
    ++h.looks;
    return false;
  });
}

void Relocalizer::propose(MappingMethod& method, const MappingInput& input, const SweepView& view,
                          const std::vector<Pose>& places) {
  for (const Pose& T_map_level : places) {
    const Pose place = normalised(T_map_level * level_at(input).inverse() * input.T_odom_base);
    Hypothesis h;
    h.match = matched(method, input, place);
    if (!h.match.ok || h.match.explained < kLeastLikeness) continue;
    const bool known =
        std::any_of(hypotheses_.begin(), hypotheses_.end(), [&](const Hypothesis& o) {
          return is_same(o.T_map_odom * input.T_odom_base, h.match.T_map_base);
        });
    if (known) continue;
    h.T_map_odom = normalised(h.match.T_map_base * input.T_odom_base.inverse());
    h.born_at_odom_m = input.T_odom_base.translation();
    h.explained = h.match.explained;
    h.seen_through = map_->seen_through(view, h.match.T_map_base * input.T_base_lidar);
    h.looks = 1;
    h.is_expected = is_expected(h.match.T_map_base, input);
    hypotheses_.push_back(h);
  }
  sort(input);
}

// Hypotheses that have come to the same place are no rivals: only the older one is kept.
void Relocalizer::sort(const MappingInput& input) {
  std::stable_sort(hypotheses_.begin(), hypotheses_.end(),
                   [](const Hypothesis& a, const Hypothesis& b) { return a.looks > b.looks; });
  std::vector<Hypothesis> apart;
  for (const Hypothesis& h : hypotheses_) {
    const Pose T_map_base = h.T_map_odom * input.T_odom_base;
    const auto same = [&](const Hypothesis& o) {
      return is_same(o.T_map_odom * input.T_odom_base, T_map_base);
    };
    if (std::none_of(apart.begin(), apart.end(), same)) apart.push_back(h);
  }
  std::stable_sort(apart.begin(), apart.end(), [](const Hypothesis& a, const Hypothesis& b) {
    return a.likeness() > b.likeness();
  });
  if (apart.size() > kMostHypotheses) apart.resize(kMostHypotheses);
  hypotheses_ = std::move(apart);
}

void Relocalizer::propose_all(MappingMethod& method, const MappingInput& input,
                              const SweepView& view, const TileMap& tiles,
                              const Surroundings& around) {
  std::vector<Pose> places;
  const Pose T_base_level = input.T_odom_base.inverse() * level_at(input);
  if (expected_) {
    const Pose guess = normalised(expected_->T_map_odom * input.T_odom_base);
    places.push_back(normalised(guess * T_base_level));
    for (const Pose& p : likely_places(tiles, input, guess, expected_->area, kMostExpected)) {
      places.push_back(normalised(p * T_base_level));
    }
  }
  const std::vector<Pose> anywhere = map_->likely_places(around, kMostPlaces);
  places.insert(places.end(), anywhere.begin(), anywhere.end());
  propose(method, input, view, places);
}

bool Relocalizer::may_be_believed(const Hypothesis& hypothesis, const MappingInput& input) const {
  const double way_m = (input.T_odom_base.translation() - hypothesis.born_at_odom_m).norm();
  return hypothesis.looks >= kLooks && hypothesis.match.converged &&
         (hypothesis.is_expected || way_m >= kWay_m) && hypothesis.likeness() >= kLikeness;
}

const Relocalizer::Hypothesis* Relocalizer::expected_one(const MappingInput& input) const {
  for (const Hypothesis& h : hypotheses_) {
    if (h.likeness() < kUnique * hypotheses_.front().likeness()) break;
    if (h.is_expected && may_be_believed(h, input)) return &h;
  }
  return nullptr;
}

const Relocalizer::Hypothesis* Relocalizer::only_one(const MappingInput& input) const {
  if (hypotheses_.empty() || !may_be_believed(hypotheses_.front(), input)) return nullptr;
  const double likeness = hypotheses_.front().likeness();
  const bool alone = hypotheses_.size() < 2 || hypotheses_[1].likeness() <= kUnique * likeness;
  return alone ? &hypotheses_.front() : nullptr;
}

Match Relocalizer::look(MappingMethod& method, const MappingInput& input, const TileMap& tiles) {
  see(input);
  if (!map_) map_ = walls_of(tiles);
  const SweepView view(input);
  const bool is_time = !looked_ns_ || input.stamp_ns - *looked_ns_ >= wait_ns_;
  follow(method, input, view, is_time ? kMostHypotheses : kFollowed);
  std::optional<Surroundings> around;
  if (is_time) {
    looked_ns_ = input.stamp_ns;
    around = surroundings(input);
    propose_all(method, input, view, tiles, *around);
    wait_ns_ = hypotheses_.empty() ? std::min(2 * wait_ns_, kLongestLook_ns) : kLook_ns;
  } else {
    sort(input);
  }
  const Hypothesis* likely = expected_one(input);
  if (likely == nullptr) likely = only_one(input);
  if (likely == nullptr) return {};
  if (!around) around = surroundings(input);
  const double share = map_->share_at(*around, likely->T_map_odom * level_at(input));
  const std::vector<Pose> alike = map_->likely_places(*around, kTooMany, kAlike * share);
  propose(method, input, view, alike);
  if (const Hypothesis* expected = expected_one(input)) return expected->match;
  const Hypothesis* found = alike.size() < kTooMany ? only_one(input) : nullptr;
  return found != nullptr ? found->match : Match{};
}

}  // namespace zloam::mapping
