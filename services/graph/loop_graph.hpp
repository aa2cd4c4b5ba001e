#pragma once
// From submaps to corrected poses: finds submaps of the same place, verifies and judges such loops,
// and fits all poses to them.
//
// A loop is accepted when four conditions hold: the two submaps overlap enough
// (verification.hpp); no other place is nearly as good, or the way between excludes it; it
// lies within the possible drift of the way between; and another loop nearby agrees with it.
// Loops that contradict the others after the fit are taken back, until a loop is removed: then they
// are tried again. The poses depend on the submaps and on the loops in force, never on the order of
// their arrival.
//
// Submaps belong to one session or to several: separate drives, each in its own map. The relative
// pose of two sessions is unknown until loops determine it: three that agree, and more than agree
// on any other. Until then each session stays in its own frame; afterwards they are one graph, in
// the frame of the first one.
//
// Frames: a place has the origin of its submap and the axes of the map according to mapping, so
// that it is seen along gravity. Places are internal to this file; loops are between submaps.

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "common/geometry/submap.hpp"
#include "graph/config.hpp"
#include "graph/place_image.hpp"
#include "graph/pose_graph.hpp"
#include "graph/verification.hpp"

namespace zloam::graph {

enum class Verdict : std::uint8_t {
  kAccepted,
  /// no other loop nearby confirms it yet
  kAlone,
  /// the two overlap too little
  kLittleOverlap,
  /// unconstrained along a direction
  kWeak,
  /// another place is nearly as good
  kNotUnique,
  /// farther off than the possible drift of the way between
  kImpossible,
  /// contradicts the others
  kTakenBack,
  kRemoved
};
const char* verdict_name(Verdict verdict);

struct Loop {
  /// numbers of the two submaps, from < to
  std::size_t from = 0, to = 0;
  /// pose of the newer submap in the older one, and its covariance, tangent at the newer one
  Pose T_from_to = Pose::Identity();
  Matrix6 covariance = Matrix6::Identity();
  double overlap = 0.0;
  double residual_m = 0.0;
  /// relative to the expectation when it was found
  double chi2 = 0.0;
  Verdict verdict = Verdict::kAlone;
  /// by a user: in force whatever contradicts it, until it is removed
  bool forced = false;
};

struct Node {
  std::size_t session = 0;
  std::uint64_t sweep = 0;
  std::int64_t instant_ns = 0;
  /// pose of the submap by mapping, and by the graph
  Pose T_map_submap = Pose::Identity();
  Pose T_world_submap = Pose::Identity();
  bool connected = true;
  /// since the first submap of the session, m
  double way_m = 0.0;
};

struct Update {
  /// loops tested for the new submap, the best one last, and loops whose verdict has changed
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

  /// Takes submaps in the order of their sweeps in each session; sessions are numbered from 0.
  Update add(const Submap& submap, std::size_t session = 0);
  /// A loop that a user names, between two submaps of one frame, from < to. The user stands for the
  /// loop that would confirm it: if it fails another condition or contradicts a loop in force, all
  /// stays as it was, and its verdict is in the update, last. forced: it comes into force at the
  /// best match of the two unless they have nothing in common, and what contradicts it is taken
  /// back until it is removed.
  Update add_loop(std::size_t from, std::size_t to, bool forced);
  /// Takes a loop out of force permanently. Nothing: there is none in force between these two. In
  /// the update are this loop and the others whose verdict has changed.
  std::optional<Update> remove(std::size_t from, std::size_t to);

  const std::vector<Node>& nodes() const;
  /// Loops in force, and those that wait for confirmation by another.
  std::vector<Loop> loops() const;
  std::size_t loops_in_force() const;
  /// Those in force from a submap of the one sweep to a later one of the other; without any, those
  /// the other way about. Two runs in one graph, after a restart of the driver, number their sweeps
  /// alike, so there may be several, and the later submap may have the lower number.
  std::vector<Loop> in_force(std::uint64_t from_sweep, std::uint64_t to_sweep) const;
  /// Number of changes of the poses.
  std::uint32_t revision() const;
  /// False: the fit to the loops in force failed, and the poses are the previous ones.
  bool fitted() const;
  /// Largest displacement of a submap in the last revision.
  double last_move_m() const;
  /// of the last optimisation
  double chi2_before() const;
  double chi2_after() const;
  /// Moves a pose of mapping to the graph's world frame, by the corrections of the submaps before
  /// and after it, interpolated in time. Unchanged while the session has no submap.
  Pose corrected(std::int64_t instant_ns, const Pose& T_map_base, std::size_t session = 0) const;
  /// The session whose frame this one uses; its own number until a loop joins it to another.
  std::size_t frame_of(std::size_t session) const;
  /// Factors of the fit: the ways between submaps, and the loops in force.
  std::vector<Between> factors() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace zloam::graph
