#pragma once
// Takes up the map again after the odometry's frame was broken off.

#include "common/geometry/fit_record.hpp"
#include "mapping/method.hpp"
#include "mapping/place_search.hpp"

namespace zloam::mapping {

class TileMap;

/// Where a sweep is searched for when nothing was seen for so long; wider with each few of the
/// sweeps that were searched for before.
SearchArea area_of(const MappingConfig& config, double gap_s, std::uint32_t attempt);

/// Matches, and once more from where that ended: from afar the iteration may have ended on its way.
Match matched_from_afar(MappingMethod& method, const MappingInput& input, const Prediction& start);

/// How far off the guess may be when nothing was seen for so long.
Matrix6 bridge_covariance(const MappingConfig& config, double gap_s);

/// Whether where it ended is not where the sensor is: it explains far less of the sweep than the
/// sweeps before were explained, less still where it has come to rest.
bool is_astray(const Match& match, const FitRecord& usual);

struct Bridged {
  /// ok: the likeliest place
  Match match;
  /// so much of the sweep lies in the map there that it needs no other to bear it out
  bool sure = false;
};

/// Matches from the guess and from the likeliest places around it, and returns the match with most
/// inliers among those whose residual is below twice the median of before (0: unknown). sure when
/// their share reaches bridge_inlier_ratio and they explain as much as usually. After a short gap the guess alone is enough, where it
/// is sure. The longer the gap, the wider the search; wider also with each few of the sweeps that
/// were searched for before (attempt), up to four times bridge_distance_m. any_heading: it may have
/// been turned unseen; a place that is turned farther than after such a gap is not sure.
Bridged bridge(MappingMethod& method, const MappingInput& input, const Prediction& guess,
               const TileMap& tiles, const MappingConfig& config, double median_residual_m,
               const FitRecord& usual, double gap_s, std::uint32_t attempt, bool any_heading);

/// Whether a match and the odometry exclude each other: one of the two is wrong.
bool contradicts(const Match& match, const Prediction& prediction);

/// Whether a sweep that matched lies better elsewhere, at any heading, as far off as after a short
/// gap. If not, its surroundings may have changed.
bool lies_better_elsewhere(MappingMethod& method, const MappingInput& input, const Match& here,
                           const TileMap& tiles, const MappingConfig& config,
                           double median_residual_m);

/// Whether sweeps that are not sure one by one bear each other out: where the platform has gone on
/// into what the map does not know, most of a sweep lies nowhere in it.
class Agreement {
 public:
  /// The frame that the next sweep in order has found; true: it is the same as of those before.
  bool add(const Pose& T_map_odom, const Pose& T_odom_base);
  void reset() { count_ = 0; }

 private:
  Pose T_map_odom_ = Pose::Identity();
  int count_ = 0;
};

}  // namespace zloam::mapping
