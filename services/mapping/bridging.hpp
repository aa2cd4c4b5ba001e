#pragma once
// Finds the pose in the map again after the odometry's frame was interrupted.

#include "common/geometry/fit_record.hpp"
#include "mapping/method.hpp"
#include "mapping/place_search.hpp"

namespace zloam::mapping {

class TileMap;

/// Area to search for a sweep after a gap without any sweep; wider after every few failed
/// attempts.
SearchArea area_of(const MappingConfig& config, double gap_s, std::uint32_t attempt);

/// Matches, and once more from the result if that is far off: the iteration may have ended early.
Match matched_from_afar(MappingMethod& method, const MappingInput& input, const Prediction& start);

/// Covariance of the guess after a gap without any sweep.
Matrix6 bridge_covariance(const MappingConfig& config, double gap_s);

/// Whether the match is at a wrong pose: it explains far less of the sweep than usual; the limit is
/// lower where the iteration has converged.
bool is_astray(const Match& match, const FitRecord& usual);

struct Bridged {
  /// ok: the likeliest place
  Match match;
  /// the share of the sweep that lies in the map is enough without confirmation by other sweeps
  bool sure = false;
};

/// Matches from the guess and from the likeliest places around it, and returns the match with most
/// inliers among those whose residual is below twice the earlier median (0: unknown). sure when
/// their share reaches bridge_inlier_ratio and they explain as much as usual. After a short gap a
/// sure match from the guess is enough. The search is wider after a longer gap and after every few
/// failed attempts, up to four times bridge_distance_m. any_heading: the platform may have rotated
/// unseen; a place rotated by more than is plausible after such a gap is not sure.
Bridged bridge(MappingMethod& method, const MappingInput& input, const Prediction& guess,
               const TileMap& tiles, const MappingConfig& config, double median_residual_m,
               const FitRecord& usual, double gap_s, std::uint32_t attempt, bool any_heading);

/// Whether match and odometry are inconsistent: one of the two is wrong.
bool contradicts(const Match& match, const Prediction& prediction);

/// Whether a matched sweep fits better elsewhere, at any heading, as far away as after a short gap.
/// If not, the surroundings may have changed.
bool lies_better_elsewhere(MappingMethod& method, const MappingInput& input, const Match& here,
                           const TileMap& tiles, const MappingConfig& config,
                           double median_residual_m);

/// Whether several sweeps that are not sure one by one agree: if the platform has moved into
/// unmapped space, most of a sweep has no counterpart in the map.
class Agreement {
 public:
  /// Takes T_map_odom found by the next sweep in order; true: enough sweeps in a row agree on it.
  bool add(const Pose& T_map_odom, const Pose& T_odom_base);
  void reset() { count_ = 0; }

 private:
  Pose T_map_odom_ = Pose::Identity();
  int count_ = 0;
};

}  // namespace zloam::mapping
