#include "mapping/bridging.hpp"

#include <algorithm>
#include <cmath>

#include "common/geometry/unobserved_motion.hpp"

namespace zloam::mapping {
namespace {

// Number of attempts before the search area widens, and number of widths before it starts again
// with the narrowest.
constexpr std::uint32_t kSweepsOfAWidth = 3;
constexpr std::uint32_t kWidths = 4;
// After kOften failed attempts only every kSeldom-th sweep is searched for.
constexpr std::uint32_t kOften = kSweepsOfAWidth * kWidths, kSeldom = 5;
// Maximum number of places matched for one sweep besides the guess: each costs a full match.
constexpr std::size_t kMostPlaces = 8;
constexpr double kFarthest_m = 30.0, kMostTurned_rad = 1.6;
constexpr double kFar_m = 0.1;
// Rotation by which a match may differ from the heading that it starts with.
constexpr double kFar_rad = 0.1;
// Minimum share of inliers among all points of a sweep, those outside the map included: with less
// the place does not resemble the sweep.
constexpr double kLeastShare = 0.25;
// Number of sweeps in a row that must find the same frame, and how closely.
constexpr int kAgreeing = 3;
constexpr double kSame_m = 0.3, kSame_rad = 0.03;
// Minimum fit relative to that of earlier sweeps. Without convergence right matches have at least
// 0.85 and wrong ones at most 0.7; converged right matches are rarely below 0.7
// (docs/experiments/2026-11-26-lost-by-fit.md).
constexpr double kLeast = 0.75, kLeastAtRest = 0.5;
// A match contradicts the odometry beyond ten sigmas (squared) and beyond kContradictory_rad or
// kSame_m, as no odometry is surer than that (docs/experiments/2026-11-27-carried-unseen.md).
constexpr double kContradiction = 100.0, kContradictory_rad = 0.1;
// Relative difference of two inlier counts below which neither place is better.
constexpr double kAlike = 0.005;
// During a shorter gap a platform cannot have moved elsewhere.
constexpr double kShortGap_s = 1.0;

}  // namespace

SearchArea area_of(const MappingConfig& config, double gap_s, std::uint32_t attempt) {
  const double width = 1.0 + static_cast<double>(attempt / kSweepsOfAWidth % kWidths);
  const double distance_m =
      width * config.bridge_distance_m + 0.5 * kUnobservedAcceleration_mps2 * gap_s * gap_s;
  const double rotation_rad = width * config.bridge_rotation_rad + kUnobservedTurn_radps * gap_s;
  return {std::min(distance_m, kFarthest_m), std::min(rotation_rad, kMostTurned_rad)};
}

Match matched_from_afar(MappingMethod& method, const MappingInput& input, const Prediction& start) {
  Match match = method.match(input, start);
  const double moved_m = (start.T_map_base.inverse() * match.T_map_base).translation().norm();
  if (!match.ok || moved_m <= kFar_m) return match;
  return method.match(input, {Pose(match.T_map_base), start.covariance});
}

namespace {

bool fits(const Match& match, const MappingConfig& config, double median_residual_m) {
  if (!match.ok || match.candidates == 0) return false;
  if (median_residual_m > 0.0) {
    return match.inlier_residual_m < config.insert_residual_factor * median_residual_m;
  }
  // No sweep was matched to this map before: a match then counts only if it has converged and its
  // residual is smaller than the gate of the matching.
  return match.converged && match.residual_m < config.voxel_planes.matcher.fine_gate_m;
}

double share(const Match& match) {
  return static_cast<double>(match.inliers) / std::max(match.candidates, 1U);
}

bool explains(const Match& match, double share, const FitRecord& usual) {
  return !usual.usual() || match.fit >= share * *usual.usual();
}

double turned_rad(const Pose& a, const Pose& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

/// Whether a has more inliers than b or, if both have about as many (as in a room that looks the
/// same from its other end), whether it is rotated less against the guess.
bool is_likelier(const Match& a, const Match& b, const Pose& guess) {
  const double more = static_cast<double>(a.inliers) / std::max(b.inliers, 1U);
  if (more > 1.0 + kAlike || more < 1.0 - kAlike) return more > 1.0;
  return turned_rad(guess, a.T_map_base) < turned_rad(guess, b.T_map_base);
}

}  // namespace

bool is_astray(const Match& match, const FitRecord& usual) {
  return match.ok && !explains(match, match.converged ? kLeastAtRest : kLeast, usual);
}

bool contradicts(const Match& match, const Prediction& prediction) {
  if (!match.ok) return false;
  const Vector6 off = log_se3(prediction.T_map_base.inverse() * match.T_map_base);
  if (off.head<3>().norm() < kSame_m && off.tail<3>().norm() < kContradictory_rad) return false;
  const Matrix6 covariance = prediction.covariance + match.covariance;
  return off.dot(covariance.ldlt().solve(off)) > kContradiction;
}

Matrix6 bridge_covariance(const MappingConfig& config, double gap_s) {
  const SearchArea area = area_of(config, gap_s, 0);
  Matrix6 covariance = Matrix6::Zero();
  covariance.diagonal().head<3>().setConstant(area.distance_m * area.distance_m);
  covariance.diagonal().tail<3>().setConstant(area.rotation_rad * area.rotation_rad);
  return covariance;
}

Bridged bridge(MappingMethod& method, const MappingInput& input, const Prediction& guess,
               const TileMap& tiles, const MappingConfig& config, double median_residual_m,
               const FitRecord& usual, double gap_s, std::uint32_t attempt, bool any_heading) {
  Bridged best;
  best.match.T_map_base = guess.T_map_base;
  const SearchArea area = area_of(config, gap_s, attempt);
  const auto take = [&](const Pose& T_map_base) {
    const Match match = matched_from_afar(method, input, {T_map_base, guess.covariance});
    if (!fits(match, config, median_residual_m) || share(match) < kLeastShare) return;
    if (best.match.ok && !is_likelier(match, best.match, guess.T_map_base)) return;
    const bool enough = share(match) >= config.bridge_inlier_ratio;
    const bool near =
        turned_rad(guess.T_map_base, match.T_map_base) <= area.rotation_rad + kFar_rad;
    best = {match, enough && near && explains(match, kLeast, usual)};
  };
  take(guess.T_map_base);
  // The sweep before was found: a match at the expected place needs no minimum share in the map.
  const double moved_m = (guess.T_map_base.inverse() * best.match.T_map_base).translation().norm();
  if (best.match.ok && gap_s <= 0.0 && moved_m < kSame_m) {
    best.sure = explains(best.match, kLeast, usual);
  }
  const bool found = best.sure && gap_s < kShortGap_s && !any_heading;
  if (!found && (attempt < kOften || attempt % kSeldom == 0)) {
    SearchArea searched = area;
    if (any_heading) searched.rotation_rad = M_PI;
    for (const Pose& p : likely_places(tiles, input, guess.T_map_base, searched, kMostPlaces)) {
      take(p);
    }
  }
  return best;
}

bool lies_better_elsewhere(MappingMethod& method, const MappingInput& input, const Match& here,
                           const TileMap& tiles, const MappingConfig& config,
                           double median_residual_m) {
  const SearchArea area{config.bridge_distance_m, M_PI};
  for (const Pose& place : likely_places(tiles, input, here.T_map_base, area, kMostPlaces)) {
    const Match match = method.match(input, {place, bridge_covariance(config, 0.0)});
    if (!fits(match, config, median_residual_m) || !match.converged) continue;
    if (match.fit > here.fit && is_likelier(match, here, here.T_map_base)) return true;
  }
  return false;
}

bool Agreement::add(const Pose& T_map_odom, const Pose& T_odom_base) {
  const Pose apart = (T_map_odom_ * T_odom_base).inverse() * T_map_odom * T_odom_base;
  const bool same =
      apart.translation().norm() < kSame_m && Eigen::AngleAxisd(apart.linear()).angle() < kSame_rad;
  count_ = same ? count_ + 1 : 1;
  T_map_odom_ = T_map_odom;
  return count_ >= kAgreeing;
}

}  // namespace zloam::mapping
