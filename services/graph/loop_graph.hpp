#pragma once
// Submaps in, corrected poses out: finds submaps that show the same place, verifies and judges such
// loops, and fits all poses to them.
//
// A loop is believed when each of four things says so: the two submaps have much of each other
// (verification.hpp); no other place is nearly as good, or the way between rules it out; it lies
// within what the way between may have drifted by; and another loop near by agrees with it. What
// contradicts the others once all are fitted is taken back. What the poses are depends on the
// submaps and on the loops that are in force, never on the order in which these came: without a
// loop all is as if it had never been.
//
// Submaps come of one session or of several: drives of their own, each in a map of its own. Where
// two sessions lie to each other is not known before loops say so: three that agree, and more than
// say anything else. Until then each stays in its own frame; afterwards they are one graph, in the
// frame of the first one.
//
// Frames: a place has the origin of its submap and the axes of the map as mapping had them, so that
// it is seen along gravity. It is a matter of this file's inside; loops are between submaps.

#include <cstdint>
#include <memory>
#include <vector>

#include "common/geometry/submap.hpp"
#include "graph/config.hpp"
#include "graph/place_image.hpp"
#include "graph/pose_graph.hpp"
#include "graph/verification.hpp"

namespace zloam::graph {

enum class Verdict : std::uint8_t {
  kAccepted,
  /// no other loop near by bears it out yet
  kAlone,
  /// too little of one is in the other
  kLittleOverlap,
  /// free along a direction
  kWeak,
  /// another place is nearly as good
  kNotUnique,
  /// farther off than the way between can have drifted
  kImpossible,
  /// contradicts the others
  kTakenBack,
  kRemoved
};
const char* verdict_name(Verdict verdict);

struct Loop {
  /// numbers of the two submaps, from < to
  std::size_t from = 0, to = 0;
  /// of the newer submap in the older one, and its covariance, tangent at the newer one
  Pose T_from_to = Pose::Identity();
  Matrix6 covariance = Matrix6::Identity();
  double overlap = 0.0;
  double residual_m = 0.0;
  /// against what was expected when it was found
  double chi2 = 0.0;
  Verdict verdict = Verdict::kAlone;
};

struct Node {
  std::size_t session = 0;
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  /// where mapping had the submap, and where the graph has it
  Pose T_map_submap = Pose::Identity();
  Pose T_world_submap = Pose::Identity();
  bool connected = true;
  /// since the first submap of the session, m
  double way_m = 0.0;
};

struct Update {
  /// looked at for the new submap, the best one last, and those whose verdict has changed
  std::vector<Loop> loops;
  /// the poses have changed
  bool revised = false;
};

class LoopGraph {
 public:
  explicit LoopGraph(const GraphConfig& config);
  ~LoopGraph();
  LoopGraph(LoopGraph&&) noexcept;
  LoopGraph& operator=(LoopGraph&&) noexcept;

  /// In the order of their sweeps in each session; sessions are numbered from 0.
  Update add(const Submap& submap, std::size_t session = 0);
  /// Takes a loop out of force, for good. False: there is none in force between these two.
  bool remove(std::size_t from, std::size_t to);

  const std::vector<Node>& nodes() const;
  /// In force, and those that wait for another to bear them out.
  std::vector<Loop> loops() const;
  std::size_t loops_in_force() const;
  /// How often the poses have changed.
  std::uint32_t revision() const;
  /// False: the loops in force could not be fitted, and the poses are those of before.
  bool fitted() const;
  /// By how much the last revision moved a submap at most.
  double last_move_m() const;
  /// of the last optimisation
  double chi2_before() const;
  double chi2_after() const;
  /// Where a pose of mapping's lies in the world that the graph has made: between two submaps as
  /// both were moved. Identity on both before the first.
  Pose corrected(std::int64_t instant_ns, const Pose& T_map_base, std::size_t session = 0) const;
  /// The session in whose frame this one lies; its own number while no loop joins it to another.
  std::size_t frame_of(std::size_t session) const;
  /// What the poses were fitted to: the ways between submaps, and the loops in force.
  std::vector<Between> factors() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::graph
