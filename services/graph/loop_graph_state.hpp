#pragma once
// State of a LoopGraph: its nodes and loops, the search for loops (loop_search.cpp), the decision
// on them (loop_decision.cpp), loops that a user names (named_loop.cpp), and the fit
// (loop_graph.cpp). Not for other folders.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "common/geometry/motion_covariance.hpp"
#include "graph/loop_graph.hpp"

namespace zloam::graph {

struct LoopGraph::State {
  explicit State(const GraphConfig& c) : config(c) {}

  // Data of a node for finding and verifying loops; place frame.
  struct Place {
    Surfaces surfaces;
    PlaceFeatures features;
    Pose T_map_place = Pose::Identity();
    Pose T_world_place = Pose::Identity();
    Pose T_place_submap = Pose::Identity();
  };
  struct Aligned {
    std::vector<Pose> poses;
    // Of each session, as State::frames.
    std::vector<std::size_t> frames;
  };
  struct Candidate {
    std::size_t from;
    Pose guess;
    std::size_t agreeing;
  };

  void add_node(const Submap& submap, std::size_t session);
  std::vector<Candidate> candidates(std::size_t to,
                                    const std::vector<std::optional<Matrix6>>& known) const;
  std::vector<Candidate> strange_candidates(std::size_t to,
                                            const std::vector<std::optional<Matrix6>>& known) const;
  std::optional<Candidate> seen_from(std::size_t from, std::size_t to) const;
  static void likeliest_first(std::vector<Candidate>& seen) {
    std::stable_sort(seen.begin(), seen.end(), [](const Candidate& a, const Candidate& b) {
      return a.agreeing > b.agreeing;
    });
  }
  std::vector<Candidate> distinct(const std::vector<Candidate>& all, std::size_t most) const;
  std::optional<Loop> best_of(std::size_t to, const std::vector<Candidate>& candidates,
                              const std::vector<std::optional<Matrix6>>& known,
                              std::vector<Loop>& looked_at) const;
  Loop verified(std::size_t to, const Candidate& candidate,
                const std::vector<std::optional<Matrix6>>& known) const;
  bool rivals(const Loop& loop, const Loop& other) const;
  std::vector<std::optional<Matrix6>> known_from(std::size_t to) const;
  std::vector<Candidate> guesses(std::size_t from, std::size_t to) const;
  Loop named(std::size_t from, std::size_t to) const;
  bool comes_into_force(const Loop& loop, Update& update);
  bool agrees(const Loop& a, const Loop& b) const;
  bool bears_out(const Loop& a, const Loop& b) const;
  bool confirm(const Loop& loop, std::vector<Loop>& decided);
  bool join(const Loop& loop, std::vector<Loop>& decided);
  void part(std::vector<Loop>& decided);
  bool settle(Loop loop, bool accepted, const std::vector<Loop*>& with, std::vector<Loop>& decided);
  bool joins_strangers(const Loop& loop) const;
  bool decide(std::size_t to, std::vector<Loop>& decided);
  Loop of_submaps(Loop loop) const;
  std::vector<Between> session_links() const;
  Aligned aligned() const;
  bool contradicts(const std::vector<Pose>& poses) const;
  Loop* contradiction(const std::vector<Pose>& poses);
  bool optimise(std::vector<Loop>& decided);
  bool try_again();
  bool move_to(const std::vector<Pose>& poses);
  std::vector<Pose> world() const;
  std::vector<Between> factors(bool with_drift) const;
  std::vector<bool> behind_the_loops() const;
  Optimised fitted_to_loops(const std::vector<Pose>& start) const;

  GraphConfig config;
  std::vector<Node> nodes;
  std::vector<Place> places;
  // Nodes of each session, and the session in whose frame it lies.
  std::vector<std::vector<std::size_t>> sessions;
  std::vector<std::size_t> frames;
  // From each node to the next one of its session.
  std::vector<Between> chain;
  std::vector<Loop> loops;
  std::uint32_t revision = 0;
  bool fitted = true;
  double chi2_before = 0.0, chi2_after = 0.0, last_move_m = 0.0;
};

}  // namespace zloam::graph
