// Decides which verified loops are accepted: those that other loops confirm, within a session and
// between two.

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "graph/loop_graph_state.hpp"

namespace zloam::graph {
namespace {

// Number of loops that must agree on the unknown relative pose of two sessions.
constexpr std::size_t kJoining = 3;

}  // namespace

// Whether the ends of both loops are near each other along the way, and the loops agree.
bool LoopGraph::State::bears_out(const Loop& a, const Loop& b) const {
  const auto is_near = [&](std::size_t i, std::size_t j) {
    return nodes[i].session == nodes[j].session &&
           std::abs(nodes[i].way_m - nodes[j].way_m) <= config.confirm_way_m;
  };
  return is_near(a.to, b.to) && is_near(a.from, b.from) && agrees(a, b);
}

// Whether the cycle of both loops and the ways between their ends closes. Corresponding ends are of
// the same session.
bool LoopGraph::State::agrees(const Loop& a, const Loop& b) const {
  if (a.to == b.to) return false;
  const auto way_m = [&](std::size_t i, std::size_t j) {
    return std::abs(nodes[i].way_m - nodes[j].way_m);
  };
  const auto along = [&](std::size_t i, std::size_t j) {
    return places[i].T_map_place.inverse() * places[j].T_map_place;
  };
  const Pose by_b = along(a.from, b.from) * b.T_from_to * along(b.to, a.to);
  const double drift_m = way_m(a.to, b.to) + way_m(a.from, b.from);
  const Matrix6 covariance =
      a.covariance + carried(b.covariance, along(a.to, b.to)) +
      diagonal_covariance(config.drift_share * drift_m, config.drift_rad_per_m * drift_m);
  return squared_distance(by_b, a.T_from_to, covariance) < config.most_chi2;
}

bool LoopGraph::State::confirm(const Loop& loop, std::vector<Loop>& decided) {
  std::vector<Loop*> bearing;
  for (Loop& other : loops) {
    // What a user forced is no evidence.
    const bool counts =
        !other.forced && (other.verdict == Verdict::kAccepted || other.verdict == Verdict::kAlone);
    if (counts && bears_out(loop, other)) bearing.push_back(&other);
  }
  return settle(loop, !bearing.empty(), bearing, decided);
}

bool LoopGraph::State::joins_strangers(const Loop& loop) const {
  return frames[nodes[loop.from].session] != frames[nodes[loop.to].session];
}

// Only loops determine the relative pose of two sessions: at least kJoining of them must agree, and
// more than contradict them.
bool LoopGraph::State::join(const Loop& loop, std::vector<Loop>& decided) {
  std::vector<Loop*> agreeing;
  std::size_t others = 0;
  for (Loop& other : loops) {
    const bool same_sessions = nodes[other.from].session == nodes[loop.from].session &&
                               nodes[other.to].session == nodes[loop.to].session;
    if (other.verdict != Verdict::kAlone || !same_sessions) continue;
    if (agrees(loop, other)) {
      agreeing.push_back(&other);
    } else {
      ++others;
    }
  }
  const bool accepted = agreeing.size() + 1 >= kJoining && agreeing.size() + 1 > others;
  return settle(loop, accepted, agreeing, decided);
}

// Sessions between which fewer than kJoining loops are left, after others were taken back, are
// separate again, and the loops between them wait for others. Sessions that a third one joins stay.
void LoopGraph::State::part(std::vector<Loop>& decided) {
  std::map<std::pair<std::size_t, std::size_t>, std::size_t> between;
  for (const Loop& loop : loops) {
    const std::size_t a = nodes[loop.from].session, b = nodes[loop.to].session;
    if (loop.verdict == Verdict::kAccepted) ++between[{std::min(a, b), std::max(a, b)}];
  }
  // The first session of those that are joined.
  std::vector<std::size_t> first;
  for (std::size_t i = 0; i < sessions.size(); ++i) first.push_back(i);
  for (const auto& [pair, count] : between) {
    if (count < kJoining) continue;
    const std::size_t a = first[pair.first], b = first[pair.second];
    std::replace(first.begin(), first.end(), std::max(a, b), std::min(a, b));
  }
  for (Loop& loop : loops) {
    const bool joins = first[nodes[loop.from].session] == first[nodes[loop.to].session];
    if (joins || loop.verdict != Verdict::kAccepted) continue;
    loop.verdict = Verdict::kAlone;
    decided.push_back(loop);
  }
}

// Stores a new loop and, if it is accepted, accepts the loops that confirm it too.
bool LoopGraph::State::settle(Loop loop, bool accepted, const std::vector<Loop*>& with,
                              std::vector<Loop>& decided) {
  if (accepted) {
    loop.verdict = Verdict::kAccepted;
    for (Loop* other : with) {
      if (other->verdict == Verdict::kAccepted) continue;
      other->verdict = Verdict::kAccepted;
      decided.push_back(*other);
    }
  }
  loops.push_back(loop);
  decided.push_back(loop);
  return accepted;
}

}  // namespace zloam::graph
