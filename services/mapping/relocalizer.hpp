#pragma once
// Finds a robot of which nothing is known except that it may be in a fixed map.
//
// The points of the last sweeps are compared with the whole map (wall_map.hpp), and the sweep is
// matched from each likely place. A place stays a hypothesis as long as each sweep is found where
// the odometry leads from it. It is accepted when it has held over some distance, explains the
// sweeps, the sweeps see through none of its walls, and no other place of the map explains nearly
// as much. A wrong place is worse than none: where two parts of the map look the same, the robot
// stays lost until its observations tell them apart.

#include <deque>
#include <optional>
#include <vector>

#include "mapping/method.hpp"
#include "mapping/place_search.hpp"
#include "mapping/wall_map.hpp"

namespace zloam::mapping {

class TileMap;

class Relocalizer {
 public:
  /// Takes one sweep, in order. ok: it is found. The map is read once, at the first call.
  Match look(MappingMethod& method, const MappingInput& input, const TileMap& tiles);
  /// Forgets what was seen before.
  void reset();
  /// Restarts with a reason to expect the next sweep around there: a place near it is accepted at
  /// once, unless another one explains more.
  void expect(const Pose& T_map_odom, const SearchArea& area);

 private:
  struct Hypothesis {
    Pose T_map_odom = Pose::Identity();
    Eigen::Vector3d born_at_odom_m = Eigen::Vector3d::Zero();
    // Sums over the sweeps matched with it: the explained share, and the share of walls that are
    // seen through.
    double explained = 0.0, seen_through = 0.0;
    int looks = 0;
    bool is_expected = false;
    // With the last sweep.
    Match match;

    double likeness() const;
  };

  void see(const MappingInput& input);
  Surroundings surroundings(const MappingInput& input) const;
  struct Expected {
    Pose T_map_odom;
    SearchArea area;
  };

  bool is_expected(const Pose& T_map_base, const MappingInput& input) const;
  /// Matches the sweep with the first `most` hypotheses.
  void follow(MappingMethod& method, const MappingInput& input, const SweepView& view,
              std::size_t most);
  /// Adds the places that are not hypotheses yet.
  void propose(MappingMethod& method, const MappingInput& input, const SweepView& view,
               const std::vector<Pose>& places);
  void propose_all(MappingMethod& method, const MappingInput& input, const SweepView& view,
                   const TileMap& tiles, const Surroundings& around);
  void sort(const MappingInput& input);
  bool may_be_believed(const Hypothesis& hypothesis, const MappingInput& input) const;
  /// The expected one, if no other explains more.
  const Hypothesis* expected_one(const MappingInput& input) const;
  /// The likeliest one, if no other explains nearly as much.
  const Hypothesis* only_one(const MappingInput& input) const;

  std::optional<WallMap> map_;
  // Points of the last sweeps, frame odom.
  std::deque<std::vector<Eigen::Vector3d>> seen_;
  // Likeliest first.
  std::vector<Hypothesis> hypotheses_;
  std::optional<Expected> expected_;
  std::optional<std::int64_t> looked_ns_;
  std::int64_t wait_ns_ = 0;
};

}  // namespace zloam::mapping
