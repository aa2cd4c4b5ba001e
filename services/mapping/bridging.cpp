#include "mapping/bridging.hpp"

#include <algorithm>

#include "mapping/place_search.hpp"

namespace zloam::mapping {
namespace {

// Sweeps that are searched for before the search widens, and how wide it gets before it begins
// again.
constexpr std::uint32_t kSweepsOfAWidth = 3;
constexpr std::uint32_t kWidths = 4;
// After so many in vain only one sweep in a few is searched for.
constexpr std::uint32_t kOften = kSweepsOfAWidth * kWidths, kSeldom = 5;
// Places that are matched for one sweep beside the guess: a match takes as long as of any sweep.
constexpr std::size_t kMostPlaces = 8;
// What a platform may have braked, accelerated or turned by without being seen.
constexpr double kAcceleration_mps2 = 2.0, kTurn_radps = 0.3;
constexpr double kFarthest_m = 30.0, kMostTurned_rad = 1.6;
constexpr double kFar_m = 0.1;
// Of a sweep's points, of those where the map may know nothing too: below it there is no likeness.
constexpr double kLeastShare = 0.25;
// Sweeps in a row that find the same frame.
constexpr int kAgreeing = 3;
constexpr double kSame_m = 0.3, kSame_rad = 0.03;
// Of what the sweeps before were explained. Right matches that have not come to rest reach 0.85,
// wrong ones 0.7; right ones that have come to rest are rarely below 0.7
// (docs/experiments/2026-11-26-lost-by-fit.md).
constexpr double kLeast = 0.75, kLeastAtRest = 0.5;
// Nobody is elsewhere after less than this.
constexpr double kShortGap_s = 1.0;

SearchArea area_of(const MappingConfig& config, double gap_s, std::uint32_t attempt) {
  const double width = 1.0 + static_cast<double>(attempt / kSweepsOfAWidth % kWidths);
  const double distance_m =
      width * config.bridge_distance_m + 0.5 * kAcceleration_mps2 * gap_s * gap_s;
  const double rotation_rad = width * config.bridge_rotation_rad + kTurn_radps * gap_s;
  return {std::min(distance_m, kFarthest_m), std::min(rotation_rad, kMostTurned_rad)};
}

bool fits(const Match& match, const MappingConfig& config, double median_residual_m) {
  if (!match.ok || match.candidates == 0) return false;
  return median_residual_m <= 0.0 ||
         match.inlier_residual_m < config.insert_residual_factor * median_residual_m;
}

double share(const Match& match) {
  return static_cast<double>(match.inliers) / std::max(match.candidates, 1U);
}

bool explains(const Match& match, double share, const FitRecord& usual) {
  return !usual.usual() || match.fit >= share * *usual.usual();
}

}  // namespace

bool is_astray(const Match& match, const FitRecord& usual) {
  return match.ok && !explains(match, match.converged ? kLeastAtRest : kLeast, usual);
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
               const FitRecord& usual, double gap_s, std::uint32_t attempt) {
  Bridged best;
  best.match.T_map_base = guess.T_map_base;
  const auto matched_from = [&](const Pose& T_map_base) {
    Prediction start = guess;
    start.T_map_base = T_map_base;
    return method.match(input, start);
  };
  const auto take = [&](const Pose& T_map_base) {
    Match match = matched_from(T_map_base);
    // From so far the iteration may have ended on its way.
    const double moved_m = (T_map_base.inverse() * match.T_map_base).translation().norm();
    if (match.ok && moved_m > kFar_m) match = matched_from(Pose(match.T_map_base));
    if (!fits(match, config, median_residual_m) || share(match) < kLeastShare) return;
    if (best.match.ok && match.inliers <= best.match.inliers) return;
    const bool enough = share(match) >= config.bridge_inlier_ratio;
    best = {match, enough && explains(match, kLeast, usual)};
  };
  take(guess.T_map_base);
  // Found before: what fits where it was expected needs no more of the map.
  const double moved_m = (guess.T_map_base.inverse() * best.match.T_map_base).translation().norm();
  if (best.match.ok && gap_s <= 0.0 && moved_m < kSame_m) {
    best.sure = explains(best.match, kLeast, usual);
  }
  const bool found = best.sure && gap_s < kShortGap_s;
  if (!found && (attempt < kOften || attempt % kSeldom == 0)) {
    const SearchArea area = area_of(config, gap_s, attempt);
    for (const Pose& p : likely_places(tiles, input, guess.T_map_base, area, kMostPlaces)) take(p);
  }
  return best;
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
